"""The page as a browser shows it: a real Chromium without a window, which asks nobody but this machine."""

import io
import os
import shutil
import sys

import numpy as np
import pytest
from PIL import Image

from levelflow import Box
from levelflow.viewer.page import standalone
from levelflow.viewer.server import Server
from levelflow.viewer.viewed import ViewedField
from tests.export.moving import growing, splitting
from tests.fields import Explicit

CHROMIUM = os.environ.get("LEVELFLOW_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium: set LEVELFLOW_CHROMIUM")
    with playwright.sync_playwright() as tool:
        browser = tool.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        )
        yield browser
        browser.close()


@pytest.fixture
def visit(browser):
    """Opens a page; in the end it must have had no errors, and have asked only where it came from."""
    pages = []

    def open_page(url, *, errors=0):
        page = browser.new_page(viewport={"width": 900, "height": 600})
        said, asked = [], []
        page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(url)
        pages.append((page, url, said, asked, errors))
        settle(page)
        return page

    yield open_page
    for page, url, said, asked, errors in pages:
        assert len(said) == errors, said
        assert asked[0] == url and all(address.startswith((url, "data:", "blob:")) for address in asked)
        page.close()


@pytest.fixture
def serve():
    servers = []

    def start(*viewed, resolution=24):
        server = Server(viewed, resolution=resolution, preview=16)
        server.start()
        servers.append(server)
        return server.url

    yield start
    for server in servers:
        server.close()


def settle(page):
    """Until the frame that is wanted is drawn, at rest."""
    page.wait_for_selector("body[data-ready=true]", timeout=30_000)
    page.wait_for_timeout(700)


def picture(page):
    """What is drawn, without the words on it."""
    page.evaluate("document.getElementById('labels').style.visibility = 'hidden'")
    return np.asarray(Image.open(io.BytesIO(page.locator("#canvas").screenshot())).convert("RGB")).astype(int)


def covered(image, left=0.0, right=0.75):
    """The share of pixels that are not ground, away from the tools."""
    part = image[:, int(left * image.shape[1]) : int(right * image.shape[1])]
    return float((np.abs(part - [251, 250, 247]).max(2) > 12).mean())


def move(page, place):
    page.locator(".time input[type=range]").first.fill(str(place))
    settle(page)


def two_parameters():
    """A ball of radius t1 at x = t2."""

    def f(x, t):
        return (x[:, 0] - t[:, 1]) ** 2 + x[:, 1] ** 2 + x[:, 2] ** 2 - t[:, 0] ** 2

    return Explicit(f, 3, 2, box=Box((-1.0,) * 3, (1.0,) * 3, ((0.3, 0.5), (-0.4, 0.4))))


def test_the_slider_changes_the_surface(visit, serve):
    page = visit(serve(ViewedField(growing(), name="ball")))
    assert (
        page.locator(".note").inner_text().startswith("There is no surface at t = -4") and covered(picture(page)) == 0
    )
    move(page, 40)
    page.keyboard.press("r")
    settle(page)
    before = picture(page)
    move(page, 36)
    after = picture(page)
    # The radius is 1/2 + t/4 at t = -4 + 5 k / 48.
    ratio = ((0.5 + (-4 + 5 * 36 / 48) / 4) / (0.5 + (-4 + 5 * 40 / 48) / 4)) ** 2
    assert covered(after) / covered(before) == pytest.approx(ratio, rel=0.1)
    assert page.locator("body").get_attribute("data-time") == "-0.25"


def test_a_frame_that_is_there_is_swapped_at_once(visit, serve):
    page = visit(serve(ViewedField(splitting(), name="two")))
    for place in (10, 20, 10, 20):
        move(page, place)
    swaps = page.evaluate("viewer.swaps")
    assert len(swaps) >= 2 and min(swaps) < 50


def test_keys_step_play_and_reset(visit, serve):
    page = visit(serve(ViewedField(splitting(), name="two")))
    home = picture(page)
    page.mouse.move(300, 300)
    page.mouse.down()
    page.mouse.move(420, 240, steps=3)
    page.mouse.up()
    settle(page)
    turned = np.abs(picture(page) - home).mean()
    page.keyboard.press("r")
    settle(page)
    # The first picture frames the preview.
    assert turned > 1 and np.abs(picture(page) - home).mean() < turned / 5
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowLeft")
    settle(page)
    assert float(page.locator("body").get_attribute("data-time")) == pytest.approx(0.8 / 48, rel=1e-6)
    page.keyboard.press(" ")
    page.wait_for_timeout(2000)
    page.keyboard.press(" ")
    settle(page)
    assert float(page.locator("body").get_attribute("data-time")) > 2 * 0.8 / 48


def test_colours_cuts_and_level_sets(visit, serve):
    page = visit(serve(ViewedField(growing().at(0.0), name="ball")))
    clay = picture(page)
    page.select_option("#colour", "curvature")
    settle(page)
    coloured = picture(page)
    assert np.abs(coloured - clay).max() > 50 and "1/length" in page.locator("#legend").inner_text()
    page.select_option("#colour", "")
    page.click("#axes button[data-axis='2']")
    settle(page)
    levels = picture(page)
    page.click("#contours")
    settle(page)
    opened = picture(page)
    assert np.abs(levels - opened).max() > 50
    # The inside has the colour of the inside: more blue than red.
    middle = opened[opened.shape[0] // 2, opened.shape[1] // 2]
    assert middle[2] > middle[0] and clay[clay.shape[0] // 2, clay.shape[1] // 2][0] > 100
    assert page.locator("#where").inner_text() == "z = 0"


def test_distances_are_in_the_units_of_the_file(visit, serve):
    center = (300.0, -20.0, 5.0)
    page = visit(serve(ViewedField(growing(center).at(1.0), name="ball")))
    page.keyboard.press("m")
    # The camera turns about the middle of the sphere, so this is the point nearest to it; the other is at the top.
    box = page.locator("#canvas").bounding_box()
    page.mouse.click(box["width"] / 2, box["height"] / 2)
    page.evaluate(
        "viewer.points.push({pane: viewer.panes[0], point: viewer.points[0].point.map(c => -c)}), viewer.redraw()"
    )
    settle(page)
    assert float(page.locator("#measured strong").inner_text()) == pytest.approx(1.5, abs=0.02)
    assert page.locator("#overlay circle").count() == 2


def test_times_can_be_typed_and_wrong_ones_are_answered(visit, serve):
    page = visit(serve(ViewedField(splitting(), name="two")))
    box = page.locator(".time input[type=text]")
    box.fill("0.1234")
    box.press("Enter")
    settle(page)
    assert page.locator("body").get_attribute("data-time") == "0.1234" and covered(picture(page)) > 0.02
    box.fill("soon")
    box.press("Enter")
    assert "“soon” is not a number; type a time from 0 to 0.8" in page.locator("#message").inner_text()


def test_a_curve_in_the_plane_lies_among_its_level_sets(visit, serve):
    page = visit(serve(ViewedField(growing(space=2).at(0.0), name="disc")))
    levels = picture(page)
    page.click("#contours")
    settle(page)
    assert covered(picture(page)) < 0.1 < covered(levels)


def test_fields_stand_side_by_side_with_one_camera(visit, serve):
    page = visit(serve(ViewedField(two_parameters(), name="a"), ViewedField(two_parameters(), name="b")))
    assert page.locator(".time").count() == 2
    page.evaluate("document.getElementById('tools').style.display = 'none'")
    image = picture(page)
    half = image.shape[1] // 2
    assert covered(image, 0, 0.5) == pytest.approx(covered(image, 0.5, 1.0), rel=0.05) and covered(image) > 0.02
    page.locator(".time input[type=range]").nth(1).fill("48")
    settle(page)
    moved = picture(page)
    assert np.abs(moved[:, :half] - image[:, :half]).max() > 50 and np.abs(moved[:, half:] - image[:, half:]).max() > 50


def test_files_leave_by_buttons_and_what_is_wrong_is_said(visit, serve, monkeypatch):
    page = visit(serve(ViewedField(growing().at(0.0), name="ball"), resolution=16), errors=1)
    with page.expect_download() as download:
        page.click("#formats button:text('PLY')")
    assert download.value.suggested_filename == "ball.ply"
    with page.expect_download() as download:
        page.click("#formats button:text('PNG')")
    with Image.open(download.value.path()) as image:
        assert image.size[0] >= 900
    monkeypatch.setitem(sys.modules, "pxr.Usd", None)
    page.click("#formats button:text('USD')")
    page.wait_for_selector("#message:not([hidden])")
    assert "pip install 'levelflow[usd]'" in page.locator("#message").inner_text()


def test_a_file_needs_no_server(visit, tmp_path):
    file = tmp_path / "two.html"
    file.write_text(standalone([ViewedField(splitting(), name="two")], [0.0, 0.2, 0.5], resolution=24), "utf-8")
    page = visit(file.as_uri())
    before = picture(page)
    move(page, 2)
    after = picture(page)
    assert np.abs(after - before).max() > 50 and 0.02 < covered(after) < covered(before)
    page.click("#axes button[data-axis='2']")
    settle(page)
    assert np.abs(picture(page) - after).max() > 50
    with page.expect_download() as download:
        page.click("#formats button:text('PLY')")
    assert (tmp_path / download.value.suggested_filename).name == "two_t=0.5.ply"
