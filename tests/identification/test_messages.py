"""What is said of an identification: only what is worth a sentence, and what the record can show."""

import plain_records
import pytest

from dehyst.identification import RecordErrors


@pytest.mark.parametrize(
    ("rate", "decades", "steady", "creeps"),
    [(0.02, 2.0, False, True), (0.3, 2.0, False, False), (0.3, 0.4, False, False), (0.02, 2.0, True, False)],
)
def test_a_drift_that_cannot_be_creep_is_not_called_so(rate, decades, steady, creeps):
    """Too large, too short to tell, or straight in time."""
    stroke = plain_records.STROKE
    lengths = dict.fromkeys(
        ("largest", "rms", "largest_with_drift", "rms_with_drift", "offset", "datum", "settled_largest", "settled_rms"),
        0.0,
    )
    errors = RecordErrors(
        "made", "training", 100, 0, **lengths, stroke=stroke, drift=rate * stroke, decades=decades, steady=steady
    )
    assert errors.creeps == creeps
