"""A reader of WAV files, in which sound cards and many recorders keep what they sampled."""

import io
import wave

import numpy as np

from dehyst import FileFormatError
from dehyst.records import Column


def read(data, allowance):
    """Return the time and the channels, as parts of the full scale."""
    with wave.open(io.BytesIO(data)) as file:
        channels, width, rate, frames = file.getparams()[:4]
        allowance.take(frames * (channels + 1), "the header")  # before any memory is used for what the header declares
        content = file.readframes(frames)
    if width not in (2, 4) or len(content) != frames * channels * width or not frames:
        raise FileFormatError(f"need {frames} frames of 16 or 32 bits; export the recording again in one of these")
    values = np.frombuffer(content, f"<i{width}").reshape(frames, channels) / 256.0**width * 2
    named = [Column(f"channel_{k + 1}", column, unit="V") for k, column in enumerate(values.T)]
    return [Column("time_s", np.arange(frames) / rate), *named]
