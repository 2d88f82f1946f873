"""What is learned of where droplets enter and leave, and of their sizes."""

import numpy as np
import pytest
from scipy.stats import norm, t

from droptrack.tracking.droplet.passages import ANY_SIZE, Passages


@pytest.mark.parametrize("n", [2, 7, 60])
def test_a_new_size_is_judged_by_students_distribution(n: int) -> None:
    """Of n sizes, the next one's distribution, by SciPy, to one of any box."""
    rng = np.random.default_rng(n)
    sizes, new = rng.normal([4, 3.5], [0.03, 0.06], (n, 2)), rng.normal([4, 3.5], 0.1, (5, 2))
    passages, mean = Passages(sizes=sizes), sizes.mean(axis=0)
    scale = np.sqrt((sizes.var(axis=0, ddof=1) + 0.05**2) * (1 + 1 / n))

    def expected(at: np.ndarray) -> np.ndarray:
        own = t.logpdf(at, n - 1, loc=mean, scale=scale)
        return np.asarray(2 * (own - norm.logpdf(at, loc=mean, scale=ANY_SIZE)).sum(axis=1))

    assert passages.evidence_of_size(new, 0.05) == pytest.approx(expected(new))


def test_one_droplet_tells_nothing_of_sizes() -> None:
    assert Passages(sizes=np.ones((1, 2))).evidence_of_size(np.ones((1, 2)), 0.1) == 0


def test_the_miss_rate_is_the_share_of_boxes_missed() -> None:
    """Of 1,000 boxes 50 are missed, in gaps of two."""
    passages = Passages()
    for _ in range(95):
        passages = passages.with_image(10)
    passages = passages.resuming(np.zeros((25, 2)), np.full(25, 2))
    assert passages.miss_rate == pytest.approx(0.05, abs=0.003)
