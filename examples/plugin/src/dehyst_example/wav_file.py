"""A reader of WAV files, in which sound cards and many recorders keep what they sampled."""

import io
import wave

import numpy as np

from dehyst import FileFormatError
from dehyst.records import Allowance, Column

TYPES = {2: "<i2", 4: "<i4"}  # bytes of a number: its type


def read(data: bytes, allowance: Allowance) -> list[Column]:
    """Return the time and the channels, as parts of the full scale."""
    with wave.open(io.BytesIO(data)) as file:
        channels, width, rate, frames = file.getparams()[:4]
        if width not in TYPES:
            raise FileFormatError(f"{8 * width} bits a number; save the file with 16 or 32 bits")
        allowance.take(frames * (channels + 1), "the header")  # before any memory is used for what the header declares
        content = file.readframes(frames)
    if len(content) != frames * channels * width or not frames:
        raise FileFormatError(f"{len(content)} bytes of the {frames * channels * width} declared; the file is damaged")
    values = np.frombuffer(content, TYPES[width]).reshape(frames, channels) / 256.0**width * 2
    named = [Column(f"channel_{k + 1}", values[:, k], unit="V") for k in range(channels)]
    return [Column("time_s", np.arange(frames) / rate), *named]
