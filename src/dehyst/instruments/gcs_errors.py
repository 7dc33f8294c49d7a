"""Error numbers of a GCS controller, as sentences."""

from __future__ import annotations

# Numbers of the public list, the common ones.
_SENTENCES = {
    1: "the syntax of a parameter is wrong",
    2: "it does not have the command",
    3: "the command was too long",
    5: "the move is not allowed with the servo off, or without a reference",
    7: "the position or voltage is out of its limits",
    8: "the velocity is out of its limits",
    10: "it was stopped by a command",
    15: "it has no such axis",
    17: "a parameter is out of its range",
    23: "it has no such axis or channel",
    24: "the number of parameters is wrong",
    25: "a number cannot be read",
    26: "a parameter is missing",
    54: "it does not have the parameter",
    57: "it has no such recorder table",
    58: "it cannot record that",
    60: "the parameter is protected",
    63: "it is still starting",
    66: "the voltage is out of its limits",
    67: "its memory does not hold the wave",
    72: "the analog input is in command of the axis",
    73: "the wave generator is in command of the axis",
    74: "the axis has no sensor or no piezo channel",
    75: "no wave table was chosen",
    76: "its input buffer ran over",
    77: "it has not recorded that much",
    78: "the recorder table records nothing",
    79: "open-loop commands are not allowed with the servo on",
    215: "the cable between controller and stage may be broken",
    302: "the voltage is out of its limits",
    303: "open-loop motion is not allowed with the servo on",
    304: "the command was too long",
    308: "it took longer than expected",
    333: "its hardware has failed",
    400: "it has no such wave generator or wave table",
    401: "the wave table is empty",
    402: "it does not have this kind of wave",
    403: "the wave is longer than its table",
    404: "the number of a wave's parameters is wrong",
    405: "a wave's value is out of its range",
    -1024: "the position error was too large, and it switched the servo off",
}
# Reported for a voltage or wave beyond what the controller allows.
LIMITS = frozenset({7, 17, 66, 302, 405})
# Reported after a requested stop.
STOPPED = 10


def sentence(number: int) -> str:
    """Return the meaning of an error number, and for limits what to try."""
    text = _SENTENCES.get(number, "see its manual's list of error codes")
    if number in LIMITS:
        text += "; its limits are narrower than it reported, request narrower limits"
    return f"error {number}: {text}"
