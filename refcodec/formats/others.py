"""Files that are often given as splats and are none: what they are, and what helps."""

import re
from pathlib import Path

from .common import TRANSFORM

_START = 512
_NAME, _AGAIN = "give it this suffix, if it is whole", "export PLY from the program that made it"
_POINTS = "save it as PLY for `refcodec fit`"

# How files begin, the suffixes of those without a beginning of their own, what they are, and what helps. The first row
# that fits counts.
_KINDS: tuple[tuple[bytes, str, str, str], ...] = (
    (rb"\Z", "", "an empty file", "restore or download it again"),
    (rb"version https://git-lfs", "", "a pointer of Git LFS, not the file", "run `git lfs pull`"),
    (rb"\s*(?i:<!doctype html|<html)", ".html", "a web page", "download the splat itself"),
    (rb"\x89C3GS|C3GS", ".c3gs", "a C3GS file", "it needs no conversion; `refcodec export` writes splats"),
    (rb"ply\s", "", "a file of the kind .ply", _NAME),
    (rb"NGSP", "", "a file of the kind .spz", _NAME),
    (rb"glTF", "", "a file of the kind .glb", _NAME),
    (rb"PK\x03\x04.{26}meta\.json", "", "a file of the kind .sog", _NAME),
    (rb"PK\x03\x04.{26}[^\0]{0,99}\.usd|#usda|PXR-USDC", ".usdz .usd .usda .usdc", "a scene of USD", _AGAIN),
    (
        rb"PK\x03\x04.{26}[^/\0]{1,99}/(data\.pkl|version|byteorder|\.data)|\x80[\2-\5]",
        ".ckpt .pt .pth .safetensors .npz .pkl",
        "a checkpoint of a training",
        "export PLY: point_cloud.ply of a 3DGS model, `ns-export gaussian-splat` of nerfstudio, `--save_ply` of gsplat",
    ),
    (rb"\x1f\x8b", "", "compressed by gzip", "unpack it, or name it .spz if it is such a file"),
    (rb"PK\x03\x04", ".zip .rar .7z .tar .gz", "an archive", "unpack it, and give the splat in it"),
    (rb"", ".ksplat .lcc .lcc2 lod-meta.json", "a splat of another format", TRANSFORM),
    (rb"", ".spx", "a splat of Reall3dViewer", "`gsbox spx2ply -i {file} -o scene.ply` makes a splat of it"),
    (rb"", ".sogs .rad .lod .gsplat .cdgs .vply", "a splat of another format", _AGAIN),
    (
        rb"\xff\xd8\xff|\x89PNG|GIF8|RIFF....WEBP|II\*\0|MM\0\*",
        ".jpg .jpeg .png .webp .tif .tiff .heic",
        "an image",
        "give the folder of photographs to `refcodec train`",
    ),
    (rb"....ftyp|\x1aE\xdf\xa3", ".mp4 .mov .mkv .avi .webm", "a video", "docs/photographs.md has the way from it"),
    (rb"LASF|ASTM-E57|# \.PCD", ".las .laz .e57 .pcd .xyz .pts", "a point cloud", _POINTS),
    (rb"solid |Kaydara FBX|OFF\s", ".obj .stl .fbx .dae .off .3ds .blend", "a mesh", "give a splat of the scene"),
)
# Folders by a name in them.
_FOLDERS = (
    ("nerfstudio_models", "a training of nerfstudio", "`ns-export gaussian-splat --load-config {file}/config.yml ...`"),
    ("ckpts", "a training of gsplat", "its trainer writes PLY with `--save_ply`"),
    (
        "lod-meta.json",
        "a splat with levels of detail",
        "`splat-transform {file}/lod-meta.json scene.ply` makes one splat",
    ),
    ("transforms.json", "a folder of photographs", "`refcodec train {file}` makes a scene of it"),
    ("images", "a folder of photographs", "`refcodec train {file}` makes a scene of it"),
)
# What the files of a suffix begin with. Others of the name are something else.
_OWN = {".ply": rb"ply\s", ".spz": rb"NGSP|\x1f\x8b", ".sog": rb"PK", ".glb": rb"glTF", ".gltf": rb"\s*\{"}


def described(file: Path, suffix: str = "") -> tuple[str, str] | None:
    """Returns what a file or folder is and what helps, for an error; None if it is not known, or what its suffix says.

    suffix: of the splat file whose name it has, "" for another name. Raises OSError.
    """
    if not file.is_file():
        rows = (row for row in _FOLDERS if (file / row[0]).exists() and not (file / "point_cloud").exists())
        return next(((f"it is {what}", advice.format(file=file)) for _, what, advice in rows), None)
    with file.open("rb") as opened:
        start = opened.read(_START)
    own = next((form for end, form in _OWN.items() if suffix.endswith(end)), None)
    if own and re.match(own, start, re.S):
        return None
    for form, suffixes, what, advice in _KINDS:
        named = not suffix and file.name.lower().endswith(tuple(suffixes.split()))
        if named or (form and re.match(form, start, re.S)):
            return f"it is {what}", advice.format(file=file.name)
    return None
