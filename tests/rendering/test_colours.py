"""Colours: the space they are interpolated in, what a scale stands for, and the bar."""

import numpy as np
import pytest

from levelflow.rendering.colours import DIVERGING, SEQUENTIAL, ColourMap, Scale, bar_width, linear, srgb, with_bar


def test_srgb_and_light_are_inverse() -> None:
    values = np.linspace(0, 1, 101)
    assert np.allclose(srgb(linear(values)), values, atol=1e-5)
    assert linear(np.array(0.5)) == pytest.approx(0.2140, abs=1e-4)


def test_a_map_goes_through_its_stops_and_ends_at_the_last() -> None:
    values = np.linspace(0, 1, len(DIVERGING.stops))
    assert np.allclose(srgb(DIVERGING(values)), DIVERGING.stops, atol=1e-3)
    assert np.allclose(DIVERGING(np.array([-3.0, 4.0])), DIVERGING(np.array([0.0, 1.0])))
    assert DIVERGING(np.zeros((4, 5))).shape == (4, 5, 3)


def test_halfway_between_two_greys_is_the_grey_that_looks_so() -> None:
    # The lightness of OKLab is the cube root of the light of a grey.
    half = ColourMap(((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))(np.array([0.5]))
    assert np.allclose(half, 0.125, atol=1e-4)


def test_magnitudes_darken_and_signs_are_lightest_in_the_middle() -> None:
    luminance = SEQUENTIAL(np.linspace(0, 1, 50)) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance) < 0).all()
    luminance = DIVERGING(np.linspace(0, 1, 51)) @ [0.2126, 0.7152, 0.0722]
    assert luminance.argmax() == 25
    assert (np.diff(luminance[:26]) > 0).all()
    assert (np.diff(luminance[25:]) < 0).all()


def test_a_scale_is_round_robust_and_symmetric_for_signed_numbers() -> None:
    values = np.linspace(-1, 3.1, 1000)
    values[:5] = 1e6
    signed, magnitude = Scale.of(values, signed=True), Scale.of(np.abs(values), signed=False)
    assert (signed.low, signed.high) == (-3.2, 3.2)
    assert (magnitude.low, magnitude.high) == (0.0, 3.2)
    assert np.allclose(signed(np.zeros(1)), DIVERGING(np.array([0.5])))
    assert np.allclose(magnitude(np.array([3.2])), SEQUENTIAL(np.ones(1)))
    assert Scale.of(np.zeros(3), signed=False).high == 1.0
    for value in (1e-7, 0.0123, 0.99, 1.0, 7.0, 9.1, 123456.0):
        assert value <= Scale.of(np.array([value]), signed=False).high * (1 + 1e-9) <= 1.34 * value


def test_the_bar_stands_beside_the_picture_with_the_colours_of_the_scale() -> None:
    picture = np.full((120, 80, 3), 7, np.uint8)
    scale = Scale(-1, 1, label="k")
    wide = with_bar(picture, scale, ground=(1.0, 1.0, 1.0))
    assert wide.shape == (120, 80 + bar_width(120), 3)
    assert np.array_equal(wide[:, :80], picture)
    column = wide[:, 80 + 6]
    high, low = (np.round(255 * srgb(scale(np.array(v)))) for v in (1.0, -1.0))
    assert np.abs(column[25].astype(float) - high).max() < 8
    assert np.abs(column[94].astype(float) - low).max() < 8
    assert (wide[:, 80 + 12 :] != 255).any()


def test_scales_and_maps_that_cannot_be() -> None:
    with pytest.raises(ValueError, match="give two or more"):
        ColourMap(((0.0, 0.0, 0.0),))
    with pytest.raises(ValueError, match="the lower one first"):
        Scale(1.0, 1.0)
    with pytest.raises(ValueError, match="1 of 2 values are not finite"):
        Scale.of(np.array([0.0, np.nan]), signed=True)
    with pytest.raises(ValueError, match="0 of 0"):
        Scale.of(np.zeros(0), signed=True)
