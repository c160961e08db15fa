import numpy as np
import pytest

from validate import metrics
from validate.flip import flip

TO_XYZ = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)


def hunt_lab(linear: tuple[float, float, float]) -> np.ndarray:
    """CIELAB of linear sRGB with the Hunt effect: a and b times L / 100 (Andersson et al. 2020, eq. 1 to 3)."""
    ratio = (TO_XYZ @ linear) / (TO_XYZ @ np.ones(3))
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    lightness = 116 * f[1] - 16
    return np.array([lightness, 5 * lightness * (f[0] - f[1]), 2 * lightness * (f[1] - f[2])])


def hyab(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    difference = hunt_lab(a) - hunt_lab(b)
    return float((abs(difference[0]) + np.hypot(*difference[1:])) ** 0.7)


def plain(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    """FLIP of two even colours: nothing to blur and no feature, the colour error alone (eq. 4 and 5)."""
    error, greatest = hyab(a, b), hyab((0, 1, 0), (0, 0, 1))
    knee = 0.4 * greatest
    return 0.95 * error / knee if error < knee else 0.95 + 0.05 * (error - knee) / (greatest - knee)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ((1.0, 1.0, 1.0), (0.0, 0.0, 0.0)),
        ((1.0, 1.0, 1.0), (0.2, 0.2, 0.2)),
        ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        ((0.3, 0.1, 0.6), (0.2, 0.25, 0.5)),
    ],
    ids=["white and black", "white and grey", "green and blue", "two colours"],
)
def test_even_colours_have_the_error_of_the_papers_formula(a, b) -> None:
    ours, truth = (np.broadcast_to(np.array(colour), (40, 40, 3)).copy() for colour in (a, b))
    # float32 all the way, through a power of 0.7: a few 1e-6; the metric's own constants have six digits.
    assert flip(ours, truth)[20, 20] == pytest.approx(plain(a, b), abs=2e-4)


def test_what_a_screen_cannot_show_is_clipped() -> None:
    white = np.ones((24, 24, 3))
    assert flip(3.0 * white, white).max() == 0.0


def test_it_is_a_distance_and_a_metric(rng: np.random.Generator) -> None:
    a, b = rng.random((2, 32, 24, 3))
    assert flip(a, b) == pytest.approx(flip(b, a), abs=1e-6)
    error = flip(a, b)
    assert error.shape == (32, 24) and error.min() >= 0 and error.max() <= 1
    metric = next(metric for metric in metrics.IMAGE if metric.name == "flip")
    assert metric.function(a, b)[0] == pytest.approx(error.mean()) and metric.function(a, a)[0] == 0.0


def test_pictures_of_different_sizes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(8, 8\).*\(8, 9\)"):
        flip(np.zeros((8, 8, 3)), np.zeros((8, 9, 3)))
