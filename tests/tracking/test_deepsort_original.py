"""The same identities as the original DeepSORT gives for the same detections and descriptors."""

import numpy as np
import pytest

from droptrack.tracking.deepsort.tracker import DeepSortTracker
from tests.tracking.deepsort_sequences import REFERENCE, sequences


@pytest.mark.parametrize(
    "name",
    ["descriptors that differ", "descriptors that mislead", "equal descriptors", "short memory"],
)
def test_identities_are_those_of_the_original(name: str) -> None:
    """Equal up to renaming, frame by frame, of all detections, confirmed or not."""
    sequence = sequences()[name]
    with np.load(REFERENCE) as reference:
        expected = reference[name]
    tracker = DeepSortTracker(sequence.parameters)
    found, are_confirmed = [], []
    confirmed: set[int] = set()
    for boxes, descriptors in sequence.frames:
        update = tracker.update(boxes, descriptors)
        confirmed |= set(update.confirmed)
        found.append(update.track_ids)
        are_confirmed.append([track_id in confirmed for track_id in update.track_ids.tolist()])
    ids = np.concatenate(found)
    np.testing.assert_array_equal(np.concatenate(are_confirmed), expected > 0)
    pairs = set(zip(ids.tolist(), np.abs(expected).tolist(), strict=True))
    assert len(pairs) == len(np.unique(ids)) == len(np.unique(np.abs(expected)))
    assert len(pairs) > 60
