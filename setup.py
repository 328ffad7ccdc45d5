"""Puts SPEC.md and the vectors into the packages. They lie outside the packages, and pyproject.toml cannot say that.

`refcodec.resources.find` looks for them in an installed package first, and then in the checkout.
"""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

# The files and folders at the top of a checkout, and their places in an installed package.
TRAVELLERS = {"SPEC.md": "refcodec/data/SPEC.md", "vectors": "conformance/data/vectors"}


class Build(build_py):
    """Copies the travellers into the packages that it builds. An editable installation needs no copies."""

    def run(self) -> None:
        """Builds the packages."""
        super().run()
        if self.editable_mode:
            return
        for source, place in TRAVELLERS.items():
            target = Path(self.build_lib, place)
            target.parent.mkdir(parents=True, exist_ok=True)
            if Path(source).is_dir():
                shutil.copytree(source, target, dirs_exist_ok=True)
            else:
                shutil.copyfile(source, target)


setup(cmdclass={"build_py": Build})
