"""Builds the manual as a site: `python -m docs -o out/manual`. It needs `pip install '.[docs]'`.

What is wrong with a page or a link is an error. The pages of an earlier build are replaced.
"""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path

from refcodec import __version__
from refcodec.statuses import USAGE

from . import document
from .stage import MANUAL, ROOT, SPEC_PAGE, stage


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m docs", description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("-o", "--output", metavar="DIR", required=True, type=Path, help="for the site")
    arguments = parser.parse_args()
    if importlib.util.find_spec("sphinx") is None or importlib.util.find_spec("myst_parser") is None:
        print("python -m docs: Sphinx is missing: pip install '.[docs]'", file=sys.stderr)
        return USAGE
    return build(arguments.output)


def build(output: Path) -> int:
    """Builds the site. Returns the exit status of Sphinx, which is 0 if there was no warning."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "pages"
        source.mkdir()
        stage(source)
        options = ["-q", "-W", "--keep-going", "-E", "-c", str(MANUAL), "-d", str(Path(folder) / "cache")]
        command = [sys.executable, "-m", "sphinx", "-b", "html", *options, str(source), str(output)]
        status = subprocess.run(command, check=False).returncode
    if status == 0:
        (output / SPEC_PAGE).write_text(document.page({"Program": f"refcodec {__version__}"}, ROOT), encoding="utf-8")
    return status


if __name__ == "__main__":
    sys.exit(main())
