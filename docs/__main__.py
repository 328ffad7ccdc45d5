"""Builds the manual as a site: `python -m docs -o out/manual`. It needs `pip install '.[docs]'`.

What is wrong with a page is an error. The pages of an earlier build are replaced.
"""

import argparse
import importlib.util
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from refcodec import __version__
from refcodec.statuses import USAGE

from . import document

ROOT = Path(__file__).resolve().parents[1]
SPEC_PAGE = "c3gs-spec.html"


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
    with tempfile.TemporaryDirectory() as cache:
        options = ["-q", "-W", "--keep-going", "-E", "-c", str(ROOT / "docs"), "-d", cache]
        command = [sys.executable, "-m", "sphinx", "-b", "html", *options, str(ROOT), str(output)]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
        status = subprocess.run(command, env=environment, check=False).returncode
    if status == 0:
        page = document.page({"Program": f"refcodec {__version__}"}, ROOT)
        (output / SPEC_PAGE).write_text(page, encoding="utf-8")
    return status


if __name__ == "__main__":
    sys.exit(main())
