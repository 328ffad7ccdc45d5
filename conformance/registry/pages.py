"""The pages and badges of the registry, made from its certificates and its matrix."""

from __future__ import annotations

import html
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from ..manifest import Manifest
from ..report.record import manifest_digest
from .certificates import Certificate
from .matrix import Matrix, is_right

PAGE, MATRIX, BADGES = "README.md", "MATRIX.md", "badges"
_COLOURS = {True: "#2e7d32", False: "#b71c1c", None: "#616161"}
# The width of a character of a badge, and the space on both sides of a text, in pixels.
_CHARACTER, _SPACE = 6.5, 12
_BADGE = """\
<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="20" role="img" aria-label="{title}">
<title>{title}</title>
<desc>{details}</desc>
<path fill="#424242" d="M4 0h{left}v20H4a4 4 0 0 1-4-4V4a4 4 0 0 1 4-4z"/>
<path fill="{colour}" d="M{edge} 0h{right}a4 4 0 0 1 4 4v12a4 4 0 0 1-4 4h-{right}z"/>
<g fill="#fff" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11">
<text x="6" y="14" textLength="{label_width}" lengthAdjust="spacingAndGlyphs">{label}</text>
<text x="{at}" y="14" textLength="{text_width}" lengthAdjust="spacingAndGlyphs">{text}</text>
</g>
</svg>
"""
_HEAD = """\
# Implementations

Decoders and encoders of C3GS, with what the [conformance suite](../conformance/README.md) and the
[matrix](MATRIX.md) say of them. `conformance registry --write` makes this page, the badges and the history from the
TOML files and the reports of this folder. [Certify](../docs/certify.md#the-registry) tells how to add one.

The suite is version {version}. The SHA-256 of its manifest is
`{digest}`.

"""
_PROOF = """
## What this proves

A report is a claim that anybody can repeat with the commands below. The registry judges each answer in it again by the
manifest, makes all its verdicts, counts and conclusions again, and compares its own SHA-256. A report that was edited
is refused.

- The registry does not run the programs. A report that was written by hand, with the digests of the manifest as
  answers, passes. Only a second run shows this.
- The grade of a list of Gaussians is not judged again, because the list is not in the report.
- Machine, time and memory are those that the report states.
- A program is identified by its version, and by the hashes of the files that its command names. Its libraries and
  modules are not hashed.
- "Conforms" means that the suite found no fault ([SPEC.md 15.4](../SPEC.md#154-decoders)). Badges name the profiles and
  levels for which all vectors are right with grade 3, and "drawing" if those of Gaussians are.
- "Earlier" means that a report is of an earlier suite. It was judged when it was added, and is not judged again. Its
  SHA-256 must still be that of the history, which only the commits of the repository protect.
"""
_MATRIX_HEAD = """\
# Every decoder with every encoder

Each encoder wrote each given scene of the forms that it takes. Each decoder then decoded the file. `same` means that
the decoder gave the digest of the second last column. A file is right if it is canonical
([SPEC.md 4.3](../SPEC.md#43-canonical-form)), if all decoders give the same digest, and if this is the digest of the
given scene. Splats (ply) are quantised, so that no digest is given for them.

`conformance registry --matrix` makes this page in a minute of a processor, and continues an interrupted run. The files
themselves are not kept. The first 16 digits of digests are shown, and [matrix.json](matrix.json) has all.

"""


def badge(certificate: Certificate) -> str:
    """Returns the badge of a certificate as SVG, which loads nothing."""
    implementation, entry = certificate.implementation, certificate.entry
    label = f"C3GS {certificate.side}"
    text = certificate.text
    details = f"{implementation.name} {implementation.version}"
    if entry:
        text = f"suite {entry['suite_version']}: {text}"
        details += f"; manifest SHA-256 {entry['manifest_sha256']}; report SHA-256 {entry['report_sha256']}"
    label_width, text_width = (round(_CHARACTER * len(words)) for words in (label, text))
    edge = label_width + _SPACE
    return _BADGE.format(
        width=edge + text_width + _SPACE,
        left=edge - 4,
        edge=edge,
        right=text_width + _SPACE - 4,
        colour=_COLOURS[certificate.good],
        at=edge + 6,
        label_width=label_width,
        text_width=text_width,
        **{name: html.escape(value) for name, value in
           {"title": f"{label}: {text}", "details": details, "label": label, "text": text}.items()},
    )  # fmt: skip


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |\n"


def _table(head: list[str], rows: list[list[str]]) -> str:
    return "".join(map(_row, [head, ["---"] * len(head), *rows]))


def _link(source: str) -> str:
    return source if source.startswith("https://") else f"../{source}"


def _repeat(certificate: Certificate) -> Iterator[str]:
    """Yields the part of the page that tells how to repeat a report."""
    i, entry = certificate.implementation, certificate.entry
    if entry is None:
        return
    yield f"\n### {i.name}\n\n"
    how = {**i.decoder, "command": i.decoder.get("serve", i.decoder["run"])}
    command = f"conformance verify-report implementations/{how['report']}"
    if "gaussians" in how:
        command += f" --gaussians '{how['gaussians']}'"
    lines = [*([how["build"]] if "build" in how else []), f"{command} -- {how['command']}"]
    yield "```sh\n" + "\n".join(lines) + "\n```\n\n"
    yield f"- [Report]({how['report']}) of {entry['started']}, SHA-256 `{entry['report_sha256']}`\n"
    yield f"- Suite {entry['suite_version']}, manifest `{entry['manifest_sha256']}`\n"
    for name, digest in (certificate.files or {}).items():
        yield f"- `{name}`: `{digest}`\n"


def page(certificates: list[Certificate], history: list[dict[str, Any]], manifest: Manifest) -> str:
    """Returns the page of the registry."""
    rows = []
    for c in certificates:
        i = c.implementation
        about = [f"[{i.name}]({_link(i.source)})", c.side, i.version, i.language, i.licence, i.author]
        rows.append([*about, f"![{c.text}]({BADGES}/{c.badge})"])
    past = [
        [e["started"][:10], e["implementation"], e["version"], e["suite_version"], e["verdict"],
         f"`{e['manifest_sha256'][:16]}`", f"`{e['report_sha256'][:16]}`"]
        for e in reversed(history)
    ]  # fmt: skip
    return "".join(
        [
            _HEAD.format(version=manifest.suite_version, digest=manifest_digest(manifest)),
            _table(["implementation", "what", "version", "language", "licence", "author", "badge"], rows),
            _PROOF,
            "\n## How to repeat the reports\n",
            *(line for c in certificates for line in _repeat(c)),
            "\n## History\n\nEvery report that was in the registry, the last one first.\n\n",
            _table(["date", "implementation", "version", "suite", "verdict", "manifest", "report"], past),
        ]
    )


def _cell(said: str | None, digest: str) -> str:
    return "-" if said is None else "same" if said == digest else f"**{said[:16] if len(said) == 64 else said}**"


def matrix_page(matrix: Matrix) -> str:
    """Returns the page of the matrix."""
    names = sorted(matrix["decoders"])
    rows = []
    for row in matrix["files"]:
        said = sorted(row["found"].values())
        digest = row["expected"] or max(said, key=said.count, default="")
        rows.append(
            [
                row["encoder"],
                row["form"],
                PurePosixPath(row["scene"]).stem,
                f"{row['bytes']:,}",
                "yes" if row["canonical"] else "**no**",
                *(_cell(row["found"].get(name), digest) for name in names),
                f"`{digest[:16]}`" if digest else row["fault"],
                "right" if is_right(row) else "**wrong**",
            ]
        )
    wrong = sum(not is_right(row) for row in matrix["files"])
    told = f"{len(rows)} files, {len(names)} decoders: {f'{wrong} files are wrong' if wrong else 'all agree'}.\n\n"
    head = ["encoder", "form", "scene", "bytes", "canonical", *names, "digest", "verdict"]
    return _MATRIX_HEAD + told + _table(head, rows)


def files(
    folder: Path, certificates: list[Certificate], history: list[dict[str, Any]], matrix: Matrix, manifest: Manifest
) -> dict[Path, str]:
    """Returns the pages and badges of a registry by path."""
    return {
        folder / PAGE: page(certificates, history, manifest),
        folder / MATRIX: matrix_page(matrix),
        **{folder / BADGES / c.badge: badge(c) for c in certificates},
    }
