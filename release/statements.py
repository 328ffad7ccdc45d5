"""Statements about the artefacts: bills of materials, the statement of how they were made, sums, and notes."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import platform
import re
import time
import uuid
from email.parser import Parser
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from .notices import Part
from .source import Source

SUMS = "SHA256SUMS"
# What the bytes of the artefacts depend on beside the commit. The libraries of Python are part of it.
TOOLS = ("setuptools", "ziglang", "markdown-it-py", "Pygments")
LICENCE = "Apache-2.0"


def version_of(name: str) -> str:
    """Returns the version of an installed package."""
    return importlib.metadata.version(name)


def dumped(document: object) -> bytes:
    """Returns a document as JSON."""
    return (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode()


def when(epoch: int) -> str:
    """Returns a time as RFC 3339 has it. epoch: seconds since 1970."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(epoch))


def bill(source: Source, metadata: str, tag: str, parts: list[Part]) -> bytes:
    """Returns the bill of materials of a wheel: CycloneDX 1.6, for PEP 770.

    metadata: METADATA of the wheel. tag: of its system. parts: of other projects, inside it. A requirement of the wheel
    is a component with its range of versions as a property, because the installer chooses the version. Those of extras
    are optional.
    """
    fields = Parser().parsestr(metadata, headersonly=True)
    name, version = str(fields["Name"]), str(fields["Version"])
    own = f"pkg:pypi/{canonicalize_name(name)}@{version}"
    needed: dict[str, list[Requirement]] = {}
    for requirement in map(Requirement, fields.get_all("Requires-Dist") or []):
        if canonicalize_name(requirement.name) != canonicalize_name(name):
            needed.setdefault(canonicalize_name(requirement.name), []).append(requirement)
    library: dict[str, object] = {"type": "library"}
    components = [
        library
        | {"bom-ref": f"inside:{part.name}", "name": part.name, "version": f"of ziglang {version_of('ziglang')}"}
        | {"licenses": [_licence(part.licence)], "scope": "required"}
        | {"properties": [{"name": "refcodec:place", "value": "inside this wheel"}]}
        for part in parts
    ]
    components += [
        library
        | {"bom-ref": f"pkg:pypi/{other}", "name": other, "purl": f"pkg:pypi/{other}"}
        | {"scope": "required" if any(r.marker is None for r in requirements) else "optional"}
        | {"properties": [{"name": "refcodec:requirement", "value": str(r)} for r in requirements]}
        for other, requirements in sorted(needed.items())
    ]
    wheel = library | {"bom-ref": own, "name": name, "version": version, "purl": own, "licenses": [_licence(LICENCE)]}
    # The same wheel has the same number, and another wheel another.
    number = uuid.uuid5(uuid.NAMESPACE_URL, "\n".join([source.commit, own, tag]))
    return dumped(
        {
            "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
            **{"bomFormat": "CycloneDX", "specVersion": "1.6", "serialNumber": f"urn:uuid:{number}", "version": 1},
            "metadata": {"timestamp": when(source.epoch), "component": wheel},
            "components": components,
            "dependencies": [{"ref": own, "dependsOn": [str(component["bom-ref"]) for component in components]}],
        }
    )


def _licence(identifier: str) -> dict[str, object]:
    return {"license": {"name" if identifier.startswith("LicenseRef-") else "id": identifier}}


def statement(source: Source, folder: Path) -> list[Path]:
    """Writes the in-toto statement over all artefacts of a folder. Nobody signs it. Returns its path."""
    path = folder / f"c3gs-{source.version}.intoto.unsigned.json"
    subjects = [{"name": p.name, "digest": {"sha256": sha256(p)}} for p in _artefacts(folder) if p != path]
    tools = {name: version_of(name) for name in TOOLS} | {"python": platform.python_version()}
    definition = {
        "buildType": "urn:c3gs:release:1",
        "externalParameters": {"command": "python -m release", "version": source.version},
        "internalParameters": {"SOURCE_DATE_EPOCH": source.epoch, "tools": tools},
        "resolvedDependencies": [{"name": "commit", "digest": {"gitCommit": source.commit}}],
    }
    # Not a service that anybody vouches for: whoever builds again gets the same sums.
    run = {"builder": {"id": "urn:c3gs:unsigned"}, "metadata": {}}
    made = {"_type": "https://in-toto.io/Statement/v1", "subject": subjects}
    made |= {"predicateType": "https://slsa.dev/provenance/v1"}
    path.write_bytes(dumped({**made, "predicate": {"buildDefinition": definition, "runDetails": run}}))
    return [path]


def sums(source: Source, folder: Path) -> list[Path]:
    """Writes SHA256SUMS over all artefacts of a folder. Returns its path."""
    path = folder / SUMS
    path.write_text("".join(f"{sha256(p)}  {p.name}\n" for p in _artefacts(folder) if p != path), encoding="utf-8")
    return [path]


def notes(source: Source, folder: Path) -> list[Path]:
    """Writes the release notes: the first section of CHANGELOG.md. Returns their path."""
    text = (source.folder / "CHANGELOG.md").read_text(encoding="utf-8")
    first = re.split(r"^## ", text, flags=re.MULTILINE)[1]
    title, _, body = first.partition("\n")
    name = source.version if title.strip() == "Unreleased" else title.strip()
    path = folder / f"c3gs-{source.version}-notes.md"
    path.write_text(f"# C3GS {name}\n{body.rstrip()}\n", encoding="utf-8")
    return [path]


def _artefacts(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))


def sha256(path: Path) -> str:
    """Returns the SHA-256 of a file in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
