"""Images of a folder and how large they are, from the first bytes of each file."""

from __future__ import annotations

import warnings
from pathlib import Path

from modsim3d.errors import InputError
from modsim3d.formats.reading.builder import MOST_PX
from modsim3d.inputs.budgets import MAX_IMAGE_BYTES
from modsim3d.inputs.opening import note_input
from modsim3d.inputs.text_files import composed
from modsim3d.inputs.validation import shown

ENDINGS = frozenset((".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp"))
_FORMATS = ("BMP", "GIF", "JPEG", "PNG", "TIFF", "WEBP")
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
        if (stem := composed(path.stem)) in found:
            raise InputError(f"folder {folder}", [f"{path.name} and {found[stem].name} have the same labels"])
        found[stem] = path
    return found


def image_size_px(path: Path) -> tuple[float, float]:
    """Width and height of the image as it is shown.

    Raises:
        InputError: The file is no image, or the image is too large.
    """
    from PIL import Image, UnidentifiedImageError

    source = f"image {path}"
    note_input(path)
    if not path.is_file():
        raise InputError(source, ["this is no ordinary file, an image was expected"])
    if (size := path.stat().st_size) > MAX_IMAGE_BYTES:
        raise InputError(source, [f"has {size:,} bytes, an image may have at most {MAX_IMAGE_BYTES:,}"])
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path, formats=_FORMATS) as image:
            width, height = image.size
            # PIL looks for the tag of a PNG behind its pixels, and would unpack all of them for it.
            lying = image.format != "PNG" and image.getexif().get(_ORIENTATION) in _LYING
    except UnidentifiedImageError:
        problem = f"cannot be read: no image of a known kind ({', '.join(_FORMATS)}), or a damaged one"
        raise InputError(source, [problem]) from None
    except Image.DecompressionBombError as error:
        raise InputError(source, [f"cannot be read: {error}"]) from None
    except Exception as error:  # PIL lets errors of many kinds through for damaged files
        raise InputError(source, [f"cannot be read: {shown(str(error))}"]) from None
    if not (0 < width <= MOST_PX and 0 < height <= MOST_PX):
        raise InputError(source, [f"width and height must be from 1 to {MOST_PX:g} pixels (got {width} and {height})"])
    return (height, width) if lying else (width, height)
