"""Builds what pyproject.toml cannot describe: the native kernel, and SPEC.md and the vectors within the packages.

`refcodec.resources.find` looks for SPEC.md and the vectors in an installed package first, and then in the checkout.
The kernel is optional. Without a C compiler there is a warning, and refcodec does with NumPy.

In a checkout that is not installed, `python setup.py build_ext --inplace` builds the kernel.
"""

import shutil
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext
from setuptools.command.build_py import build_py

# The files and folders at the top of a checkout, and their places in an installed package.
TRAVELLERS = {"SPEC.md": "refcodec/data/SPEC.md", "vectors": "conformance/data/vectors"}
# refcodec.native.library loads the file of this name.
LIBRARY = "kernel.so"
# Products of float32 are rounded by themselves (SPEC 9.2). Nothing of a build differs with its folder. A square root is
# one instruction, as nobody asks for its errno.
FLAGS = ["-std=gnu11", "-O3", "-g0", "-fvisibility=hidden", "-ffp-contract=off", "-fno-math-errno", "-pthread"]
KERNEL = Extension(
    "refcodec.native.kernel",
    ["refcodec/native/kernel.c"],
    depends=["refcodec/native/kernel.h", "refcodec/native/module.h", "refcodec/native/variant.h"],
    extra_compile_args=FLAGS,
    extra_link_args=["-pthread"],
    optional=True,
)


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


class BuildLibrary(build_ext):
    """Builds the kernel. It is a plain shared library, which depends on no version of Python."""

    def get_ext_filename(self, fullname: str) -> str:
        """Returns the path of the library."""
        return str(Path(*fullname.split(".")[:-1], LIBRARY))


class Wheel(bdist_wheel):
    """Makes a wheel for each Python 3, on this platform alone if it has the kernel."""

    def get_tag(self) -> tuple[str, str, str]:
        """Returns the tags of Python, its ABI and the platform."""
        there = any(Path(self.bdist_dir).rglob(LIBRARY))
        return "py3", "none", super().get_tag()[2] if there else "any"


setup(ext_modules=[KERNEL], cmdclass={"build_py": Build, "build_ext": BuildLibrary, "bdist_wheel": Wheel})
