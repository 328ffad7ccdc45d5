"""The page and the badges of the registry, made from its certificates and its matrix."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import jinja2

from ..manifest import Manifest
from ..report.record import manifest_digest
from .certificates import Certificate
from .matrix import Matrix, Row

PAGE, BADGES = "README.md", "badges"
_COLOURS = {True: "#2e7d32", False: "#b71c1c", None: "#616161"}
# Texts of the TOML files need no escape in Markdown (implementations.py).
_TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent),
    autoescape=jinja2.select_autoescape(["svg"]),
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    keep_trailing_newline=True,
)


def badge(certificate: Certificate) -> str:
    """Returns the badge of a certificate as SVG, which loads nothing."""
    label, text = f"C3GS {certificate.side}", certificate.text
    if certificate.record:
        text = f"suite {certificate.record.suite.version}: {text}"
    # A character takes some 7 pixels.
    edge, right = (7 * len(words) + 12 for words in (label, text))
    colour = _COLOURS[certificate.good]
    return _TEMPLATES.get_template("badge.svg").render(label=label, text=text, edge=edge, right=right, colour=colour)


def _shown(row: Row, decoders: list[str]) -> tuple[Row, str, list[str]]:
    """Returns a row of the matrix, the name of its scene, and the texts of its decoders' answers."""
    same = {None: "-", row.digest: "same"}
    texts = [same.get(answer, f"**{answer}**") for answer in map(row.digests.get, decoders)]
    return row, PurePosixPath(row.scene).stem, texts


def files(folder: Path, certificates: list[Certificate], matrix: Matrix, manifest: Manifest) -> dict[Path, str]:
    """Returns the page and the badges of a registry by path."""
    decoders = sorted({name for row in matrix for name in row.digests})
    page = _TEMPLATES.get_template("page.jinja").render(
        certificates=certificates,
        decoders=decoders,
        matrix=[_shown(row, decoders) for row in matrix],
        wrong=sum(not row.right for row in matrix),
        manifest=manifest,
        digest=manifest_digest(manifest),
    )
    return {folder / PAGE: page, **{folder / BADGES / c.badge: badge(c) for c in certificates}}
