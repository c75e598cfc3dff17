"""The viewer of a whole body in a real browser: what it shows is what Python says, and it turns."""

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from selenium.webdriver import ActionChains, Chrome
from selenium.webdriver.common.actions.pointer_input import PointerInput
from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
from selenium.webdriver.common.by import By

from pgdl_lab.surrogate.surrogate import Surrogate
from pgdl_lab.surrogate.viewer import page
from tests.needs import need
from tests.surrogate.browser import browser
from tests.surrogate.test_viewer import settled
from tests.whole import learnt, observed_body


@pytest.fixture(scope="module")
def surrogate(tmp_path_factory: pytest.TempPathFactory) -> Surrogate:
    return learnt(tmp_path_factory.mktemp("run"), rounds=1)


@pytest.fixture(scope="module")
def window(surrogate: Surrogate, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    need("chromium", "chromedriver")
    folder = tmp_path_factory.mktemp("page")
    path = folder / "viewer.html"
    path.write_text(page(surrogate, observed_body(), "A </script> finger"), encoding="utf-8")
    with browser(folder) as opened:
        opened.get(path.as_uri())
        yield opened
        assert opened.get_log("browser") == []  # neither errors nor refused requests
        assert opened.execute_script("return performance.getEntriesByType('resource').length") == 0


def pixels(window: Chrome) -> np.ndarray:
    settled(window)
    return np.array(Image.open(io.BytesIO(window.get_screenshot_as_png())).convert("RGB")).astype(int)


def pixel_of(window: Chrome, place: np.ndarray) -> tuple[int, int]:
    """Column and row of the window where a place [mm] is drawn."""
    x, y = window.execute_script(
        "const box = stage.getBoundingClientRect(), [x, y] = at(...arguments[0]); return [box.x + x, box.y + y]",
        place.tolist(),
    )
    return int(x), int(y)


GROUND = (14, 20, 32)


@pytest.mark.parametrize("kpa", [0.0, 3.7, 10.0])
def test_numbers_are_those_of_python(window: Chrome, surrogate: Surrogate, kpa: float) -> None:
    window.execute_script("set(arguments[0])", kpa)
    settled(window)
    shown = np.array(window.execute_script("return Array.from(displacements(state.kpa))")).reshape(-1, 3)
    rest = np.array(window.execute_script("return Array.from(points)")).reshape(-1, 3)
    assert np.abs(shown - surrogate.predict(rest, kpa)).max() < 1e-4
    assert len(rest) < len(surrogate.domain.points_mm)  # the surface alone
    x, _, z = surrogate.tip_mm + surrogate.predict([surrogate.tip_mm], kpa)[0]
    told = window.find_element(By.ID, "readings").text.replace("−", "-")
    assert f"{x:.2f} mm" in told and f"{z:.2f} mm" in told


def test_both_halves_are_seen_and_one_where_it_is_cut(window: Chrome) -> None:
    window.execute_script("change({...FRONT, half: false, colour: 'size'}); set(0)")
    # from the front one looks at the half that is not meshed
    middle = np.array([5.0, -8.0, 5.0])
    whole = pixels(window)
    column, row = pixel_of(window, middle)
    assert tuple(whole[row, column]) != GROUND
    window.find_element(By.ID, "half").click()
    cut = pixels(window)
    drawn, left = ((np.abs(image[80:400, 250:900] - GROUND).max(axis=2) > 3).sum() for image in (whole, cut))
    assert 0.3 * drawn < left < 0.95 * drawn
    assert window.find_element(By.ID, "half").get_attribute("aria-pressed") == "true"
    window.find_element(By.ID, "half").click()


def test_mouse_and_touch_turn_the_body_and_keep_the_pressure(window: Chrome) -> None:
    window.execute_script("change(FRONT); set(7)")
    settled(window)
    before, stage = pixels(window), window.find_element(By.ID, "stage")
    ActionChains(window).drag_and_drop_by_offset(stage, 150, 75).perform()
    yaw, pitch, kpa = window.execute_script("return [state.yaw - FRONT.yaw, state.pitch - FRONT.pitch, state.kpa]")
    assert [yaw, pitch, kpa] == pytest.approx([1.0, 0.5, 7.0], abs=0.05)
    assert (np.abs(pixels(window) - before).max(axis=2) > 10).sum() > 1000
    touch = ActionChains(window, devices=[PointerInput("touch", "finger")])
    touch.w3c_actions.pointer_action.move_to(stage, 0, 0).pointer_down().move_to(stage, -150, 0).pointer_up()
    touch.perform()
    assert window.execute_script("return state.yaw - FRONT.yaw") == pytest.approx(0.0, abs=0.1)
    window.find_element(By.ID, "front").click()
    settled(window)
    assert window.execute_script("return state.yaw === FRONT.yaw && state.pitch === FRONT.pitch")


def test_places_are_drawn_where_they_are_seen(window: Chrome) -> None:
    """Turned to look along y, x is to the right and z up, in the scale that the bar tells."""
    window.execute_script("change({yaw: 0, pitch: 0, zoom: 1}); set(0)")
    settled(window)
    scale = window.execute_script("return view.scale")
    origin, right, up = (
        np.array(pixel_of(window, np.array(place))) for place in ([0.0, 0, 0], [10.0, 3, 0], [0.0, -3, 10])
    )
    assert right - origin == pytest.approx([10 * scale, 0], abs=1.5)
    assert up - origin == pytest.approx([0, -10 * scale], abs=1.5)
    window.execute_script("change({yaw: 0, pitch: Math.PI / 2})")  # from above
    back = np.array(pixel_of(window, np.array([0.0, 10.0, 0.0]))) - pixel_of(window, np.zeros(3))
    assert back == pytest.approx([0, -10 * scale], abs=1.5)
    window.execute_script("change(FRONT)")


def test_keys_wheel_and_colours(window: Chrome) -> None:
    page_body = window.find_element(By.TAG_NAME, "body")
    for key, colour in (("2", "x"), ("3", "y"), ("4", "z"), ("5", "error"), ("1", "size")):
        page_body.send_keys(key)
        assert window.execute_script("return state.colour") == colour
    window.execute_script("set(5)")
    page_body.send_keys("d")
    assert window.execute_script("return [state.yaw - FRONT.yaw, state.kpa]") == pytest.approx([0.1, 5])
    ActionChains(window).scroll_from_origin(_over(window), 0, -300).perform()
    settled(window)
    assert window.execute_script("return state.zoom") == pytest.approx(np.exp(0.5), rel=0.01)
    window.execute_script("change(FRONT)")


def _over(window: Chrome) -> ScrollOrigin:

    return ScrollOrigin.from_element(window.find_element(By.ID, "stage"))


@pytest.mark.parametrize(("width", "height"), [(360, 640), (640, 360)])
def test_fits_a_phone(window: Chrome, width: int, height: int) -> None:
    screen = {"width": width, "height": height, "deviceScaleFactor": 2, "mobile": True}
    window.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    settled(window)
    assert window.execute_script("return document.documentElement.scrollWidth") <= width
    boxes = window.execute_script(
        "return [...document.querySelectorAll('button, #slider')].map((e) => e.getBoundingClientRect().toJSON())"
    )
    assert all(box["left"] >= 0 and box["right"] <= width and box["bottom"] <= height for box in boxes)
    assert all(box["height"] >= 30 for box in boxes)
    (x0, y0, z0), (x1, y1, z1) = window.execute_script("return data.boundsMm")
    corners = np.array([[x, y, z] for x in (x0, x1) for y in (y0, y1) for z in (z0, z1)])
    seen = np.array([pixel_of(window, corner) for corner in corners])
    stage = window.execute_script("return stage.getBoundingClientRect().toJSON()")
    assert (seen.min(axis=0) >= [0, stage["top"]]).all() and (seen.max(axis=0) <= [width, stage["bottom"]]).all()
    assert np.ptp(seen[:, 0]) > 0.25 * width
    window.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    settled(window)


def test_surrogate_alone_has_nothing_to_be_compared_with(surrogate: Surrogate, tmp_path: Path) -> None:
    text = surrogate._repr_html_()
    assert "of the whole body" in text and "<iframe" in text
    assert '"errors": ""' in page(surrogate, None, "alone")
