import base64
import json
import re
import zlib

import numpy as np
import pytest

from levelflow import EmptyLevelSet
from levelflow.viewer.packing import unpack
from levelflow.viewer.page import description, page, sliders, standalone
from levelflow.viewer.viewed import ViewedField
from tests.export.moving import growing, radius
from tests.fields import placed


def embedded(document, name):
    return json.loads(re.search(f'<script type="application/json" id="{name}">(.*?)</script>', document)[1])


def inflated(text):
    return zlib.decompress(base64.b64decode(text))


def test_a_file_holds_its_frames():
    said = []
    document = standalone(
        [ViewedField(growing(), name="ball"), ViewedField(growing().at(0.0), name="still")], [-3.0, 0.0, 0.5],
        resolution=24, on_frame=lambda one, t: said.append((one.name, t)),
    )  # fmt: skip
    assert said == [("ball", -3.0), ("ball", 0.0), ("ball", 0.5), ("still", None)]
    assert embedded(document, "meta")["times"] == [[-3.0, 0.0, 0.5]]
    ball, still = embedded(document, "frames")["packed"]
    assert list(ball) == ["-3.0", "0.0", "0.5"] and list(still) == [""]
    header, arrays = unpack(inflated(ball["0.5"]["surface"]))
    assert np.allclose(np.linalg.norm(arrays["position"], axis=1), radius(0.5), atol=2e-3) and header["time"] == [0.5]
    assert "no surface" in unpack(inflated(ball["-3.0"]["surface"]))[0]["note"]
    assert "connect-src 'none'" in document and "http://" not in document and "https://" not in document


def test_a_file_holds_values_around_its_surfaces():
    document = standalone([ViewedField(growing(), name="ball")], [0.0], resolution=8)
    frames = embedded(document, "frames")
    grid = inflated(frames["packed"][0]["0.0"]["grid"])
    n, most = frames["grid"], np.frombuffer(grid, "<f4", 1)[0]
    q = np.frombuffer(grid, np.int8, offset=4).astype(float).reshape(n, n, n)
    line = np.linspace(-1, 1, n)
    z, y, x = np.meshgrid(line, line, line, indexing="ij")
    truth = 3 * (np.sqrt(x**2 + y**2 + z**2) - radius(0.0))
    error = np.abs(most * q * np.abs(q) / 127**2 - truth)
    assert most == pytest.approx(truth.max()) and error.max() < most / 100
    assert error[np.abs(truth) < 0.1].max() < 0.02


def test_a_curve_in_the_plane_has_a_file_too():
    document = standalone([ViewedField(growing(space=2), name="disc")], [0.0], resolution=16)
    frames = embedded(document, "frames")
    assert len(inflated(frames["packed"][0]["0.0"]["grid"])) == 4 + frames["grid"] ** 2


def test_names_are_words_and_never_markup():
    name = "</script><b>&@scripts@.ply"
    document = page(description([ViewedField(growing(), name=name)], [[0.0]], resolution=8, preview=8))
    assert name not in document and "&lt;/script&gt;&lt;b&gt;&amp;@scripts@.ply" in document
    assert embedded(document, "meta")["viewed"][0]["name"] == name


def test_sliders_span_the_intervals_of_all():
    ball, two = ViewedField(growing(), name=""), ViewedField(placed(3, 2), name="")
    assert sliders([ball], steps=5) == [[-4.0, -3.0, -2.0, -1.0, 0.0, 1.0]]
    assert [(times[0], times[-1]) for times in sliders([ball, two])] == [(-4.0, 5.0), (-1.0, 0.5)]
    assert sliders([ViewedField(growing().at(0.0), name="")]) == []


def test_what_has_no_file_is_refused():
    ball = ViewedField(growing(), name="ball")
    with pytest.raises(ValueError, match="box has 2 parameters, and a page in a file has one slider; leave --html out"):
        standalone([ViewedField(placed(3, 2), name="box")], [0.0])
    with pytest.raises(ValueError, match=r"ball was solved for times from -4 to 1, and none of \[2.0, 3.0\]"):
        standalone([ball], [2.0, 3.0])
    with pytest.raises(EmptyLevelSet, match=r"no surface at any of the times \[-3.0, -2.5\]; ask for others"):
        standalone([ball], [-3.0, -2.5], resolution=8)
