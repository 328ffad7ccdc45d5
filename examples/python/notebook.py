# %% [markdown]
# # A C3GS file in a notebook
#
# Editors with support for cells, such as VS Code, Spyder or Jupyter with jupytext, open this file as a notebook.
# It needs `pip install '.[render]'`. Run it in the project folder, or give another file.

# %%
import sys
from pathlib import Path

import numpy as np

import refcodec

FILE = sys.argv[1] if len(sys.argv) == 2 else "vectors/valid/trained-caliterra.c3gs"

# %% [markdown]
# `open` reads only the header. A file on the last line of a cell displays itself.

# %%
file = refcodec.open(FILE)
print(file)
file

# %% [markdown]
# A scene displays itself with a picture.

# %%
scene = file.decode()
print(scene)
scene

# %% [markdown]
# Its values are numpy arrays.

# %%
kept = scene.masks.sum(axis=1)
print(f"positions: {scene.positions.dtype} {list(scene.positions.shape)}")
print(f"an anchor keeps {kept.mean():.2f} of {scene.offset_count} offsets")
print(f"the largest scale of a Gaussian is {np.exp(scene.scalings[:, 3:].max()):.3f} world units")

# %% [markdown]
# Bytes of each part, and bits per anchor.

# %%
for name, size in scene.sizes.items():
    print(f"{name:12} {size:8,} bytes  {8 * size / scene.anchor_count:7.2f} bits per anchor")

# %% [markdown]
# An image from the camera of the file, and one from the side.

# %%
image = scene.render(scene.camera.resized(160, 120))
side = scene.render(scene.orbit(4)[1].resized(160, 120))
print(f"image: {image.dtype} {list(image.shape)}, mean colour {image.mean(axis=(0, 1)).round().tolist()}")

# %% [markdown]
# Encoding the scene gives the same file, byte for byte.

# %%
data = refcodec.encode(scene)
print(f"encoded again: {len(data):,} bytes, the same file: {data == Path(FILE).read_bytes()}")

# %% [markdown]
# The error for a damaged file states the location of the damage, and the clause.

# %%
damaged = bytearray(data)
damaged[-100] ^= 1
try:
    refcodec.decode(damaged)
except refcodec.BitstreamError as error:
    print(f"error {error.kind.code}, SPEC.md {error.kind.clause}, byte {error.offset}")
