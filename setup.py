"""What pyproject.toml cannot say: SPEC.md and the vectors lie outside the packages, and travel in them.

`refcodec.resources.find` looks for them in an installed package first, then in the checkout.
"""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

# What a checkout has at its top, and where it stands in an installed package.
TRAVELLERS = {"SPEC.md": "refcodec/data/SPEC.md", "vectors": "conformance/data/vectors"}


class Build(build_py):
    """Copies the travellers into the packages that it builds, except where the checkout itself is installed."""

    def run(self) -> None:
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
