"""Environment images with one lamp in a known direction."""

import numpy as np
import OpenEXR


def save_exr(path, pixels):
    """Writes float32 OpenEXR; NaN and infinities too."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": np.ascontiguousarray(pixels, dtype=np.float32)}) as file:
        file.write(str(path))
    return path


def lamp(direction, height=32, radiance=20.0):
    """A lamp of 25 degrees radius in a dim room, texel by texel from the formula of docs/conventions.md."""
    row, column = np.mgrid[:height, : 2 * height]
    theta, phi = np.pi * (row + 0.5) / height, 2 * np.pi * (column + 0.5) / (2 * height) - np.pi
    toward = np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)], -1)
    lit = toward @ (np.asarray(direction) / np.linalg.norm(direction)) > np.cos(np.radians(25))
    return np.where(lit, radiance, 0.05).astype(np.float32)[..., None].repeat(3, -1)
