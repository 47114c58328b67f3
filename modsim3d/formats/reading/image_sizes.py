"""Images of a folder and how large they are, from the first bytes of each file."""

from __future__ import annotations

import warnings
from pathlib import Path

from modsim3d.errors import InputError

ENDINGS = frozenset((".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp"))
_ORIENTATION, _LYING = 274, (5, 6, 7, 8)
"""The tag of a photograph that says how to rotate it, and the values of it that swap width and height."""


def images_in(folder: Path) -> dict[str, Path]:
    """Image files of a folder, by name without ending.

    Raises:
        InputError: Two images have the same name.
    """
    found: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in ENDINGS:
            continue
        if path.stem in found:
            raise InputError(f"folder {folder}", [f"{path.name} and {found[path.stem].name} have the same labels"])
        found[path.stem] = path
    return found


def image_size_px(path: Path) -> tuple[float, float]:
    """Width and height of the image as it is shown.

    Raises:
        InputError: The file is no image, or the image is too large.
    """
    from PIL import Image

    try:
        with (
            warnings.catch_warnings(action="ignore", category=Image.DecompressionBombWarning),
            Image.open(path) as image,
        ):
            width, height = image.size
            # PIL looks for the tag of a PNG behind its pixels, and would unpack all of them for it.
            lying = image.format != "PNG" and image.getexif().get(_ORIENTATION) in _LYING
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise InputError(f"image {path}", [f"cannot be read: {error}"]) from None
    return (height, width) if lying else (width, height)
