"""What lies between samples: read by cubics, with a share of their variance."""

import numpy as np

from lmeasure.iso9283.paths import passage, share

QUARTER = np.array([-0.0546875, 0.8203125, 0.2734375, -0.0390625])
"""Of the cubic through four samples a quarter of the way from the second to the third: -7/128, 105/128, 35/128, -5/128."""


def test_what_is_read_between_samples_has_a_share_of_their_variance() -> None:
    np.testing.assert_allclose(share(np.array([0.0, 0.25, 0.5])), [1.0, (QUARTER**2).sum(), 2.0 * (81 + 1) / 256])
    # a parabola's passage, and the weights with which it is read there
    time_s = np.array([[0.0, 0.1, 0.2, 0.3], [0.0, 0.1, 0.2, 0.9]])
    ahead = time_s**2 - 0.15**2
    straight = (0.15**2 - 0.1**2) / (0.2**2 - 0.1**2)
    at, weights = passage(time_s, ahead, np.full(2, straight), np.ones(2, np.bool_))
    np.testing.assert_allclose(at, [0.15, 0.1 + 0.1 * straight], rtol=1e-9)
    np.testing.assert_allclose((weights * time_s**2).sum(axis=1), 0.15**2, rtol=1e-9)
    np.testing.assert_allclose(weights[1], [0.0, 1.0 - straight, straight, 0.0])
