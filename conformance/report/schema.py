"""The JSON schema of a record; `python -m conformance.report.schema` prints it.

Every field of an object is required, except those listed as optional, and no other field is allowed.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

Schema = dict[str, Any]


def _object(optional: Sequence[str] = (), /, **fields: Schema) -> Schema:
    required = [name for name in fields if name not in optional]
    return {"type": "object", "properties": fields, "required": required, "additionalProperties": False}


def _list(items: Schema, **more: int) -> Schema:
    return {"type": "array", "items": items, **more}


def _map(values: Schema) -> Schema:
    return {"type": "object", "additionalProperties": values}


def _or_null(schema: Schema) -> Schema:
    return {"anyOf": [schema, {"type": "null"}]}


def _enum(*values: str) -> Schema:
    return {"enum": list(values)}


STATUSES = ("failed", "crashed", "unexpected", "known", "passed", "skipped")
REPORT, REPORT_VERSION = "c3gs-conformance-report", 5
_TEXT, _FLAG, _INTEGER = {"type": "string"}, {"type": "boolean"}, {"type": "integer"}
_COUNT, _NUMBER = {"type": "integer", "minimum": 0}, {"type": "number", "minimum": 0}
_POSITIVE = {"type": "number", "exclusiveMinimum": 0}
_GRADE = {**_COUNT, "maximum": 3}
_TEXTS = _list(_TEXT)
_SHA256 = {"type": "string", "pattern": "^[0-9a-f]{64}$"}
_GROUP = {"type": "string", "pattern": "^(any|rendering|(tiny|main) [0-9]+)$"}
_COVERAGE = _map(_object(vectors=_COUNT, run=_COUNT, right=_COUNT))
_PARTS = _enum("head", "positions", "masks", "planes", "features", "scalings", "offsets", "weights", "splat", "digests")
_LEVEL = _or_null(_COUNT)

# The description that a decoder gives of itself.
DECODER = _object(
    ("language", "author", "url", "notes"),
    name={"type": "string", "minLength": 1},
    version=_TEXT,
    language=_TEXT,
    author=_TEXT,
    url=_TEXT,
    notes=_TEXT,
)
_DIAGNOSIS = _object(
    failing=_COUNT,
    passing=_COUNT,
    text=_TEXTS,
    probes=_list(_object(clause=_TEXT, title=_TEXT, vectors=_COUNT, vector=_TEXT, text=_TEXT)),
    requirements=_list(_object(requirement=_TEXT, text=_TEXT, score=_NUMBER, failing=_COUNT, passing=_COUNT)),
)
_ACCEPTED = _object(result={"const": "accepted"}, digest=_SHA256)
_REJECTED = _object(result={"const": "rejected"}, code=_INTEGER, name=_TEXT, offset=_COUNT, clause=_TEXT)
_GAUSSIANS = _object(result={"const": "gaussians"}, tolerance=_NUMBER)
_FOUND = _object(
    result=_enum("accepted", "rejected", "crashed"),
    **{name: _or_null(_INTEGER) for name in ("status", "signal", "code", "offset")},
    digest=_or_null(_SHA256),
    text=_TEXT,
    differing=_list(_PARTS),
)
_PROBE = _object(
    name=_TEXT, anchor=_COUNT, index=_COUNT, found=_INTEGER, wanted=_INTEGER, clauses=_list(_TEXT, minItems=1)
)
_VECTOR = _object(
    **dict.fromkeys(("id", "title", "text", "input", "stderr"), _TEXT),
    **dict.fromkeys(("requirements", "features", "flags", "clauses", "divergence", "hex"), _TEXTS),
    **{"class": _enum("valid", "malformed", "invalid", "unsupported", "resource")},
    status=_enum(*STATUSES),
    grade=_GRADE,
    operation=_enum("decode", "gaussians"),
    profile=_or_null(_TEXT),
    level=_LEVEL,
    expected={"oneOf": [_ACCEPTED, _REJECTED, _GAUSSIANS]},
    found=_or_null(_FOUND),
    probe=_or_null(_PROBE),
    seconds=_NUMBER,
    peak_bytes=_or_null(_COUNT),
)
RECORD = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": "Report of a run of the C3GS conformance suite",
    "description": "conformance/README.md states the meaning of each field.",
    **_object(
        report={"const": REPORT},
        report_version={"const": REPORT_VERSION},
        suite=_object(version=_TEXT, format_version=_INTEGER, manifest_sha256=_SHA256, vectors=_map(_GROUP)),
        runner=_object(
            **dict.fromkeys(("version", "python", "platform", "started"), _TEXT),
            **dict.fromkeys(("interrupted", "trace", "serve"), _FLAG),
            select=_TEXTS,
            seconds=_NUMBER,
            jobs={"type": "integer", "minimum": 1},
            grade={**_GRADE, "minimum": 1},
            slow=_POSITIVE,
        ),
        decoder=_object(description=DECODER, command=_TEXTS, gaussians=_or_null(_TEXTS), files=_map(_SHA256)),
        verdict=_object(
            conforms=_FLAG,
            grade=_or_null(_GRADE),
            counts=_object(**dict.fromkeys(STATUSES, _COUNT)),
            not_run=_COUNT,
        ),
        profiles=_list(
            _object(
                profile=_enum("tiny", "main", "rendering"),
                level=_LEVEL,
                verdict=_enum("conforms", "fails", "incomplete"),
                needed=_COUNT,
                right=_COUNT,
            )
        ),
        requirements=_COVERAGE,
        features=_COVERAGE,
        diagnosis=_or_null(_DIAGNOSIS),
        vectors=_list(_VECTOR),
        sha256=_SHA256,
    ),
}

if __name__ == "__main__":
    print(json.dumps(RECORD, indent=1))
