"""The viewer in a real browser: what it shows is what Python says."""

import io
import re
from collections.abc import Iterator
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from mlflow import MlflowClient
from PIL import Image
from selenium.webdriver import ActionChains, Chrome, Keys
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

from pgdl_lab.core.registry import plugin
from pgdl_lab.running.folders import RUN_ID
from pgdl_lab.surrogate.surrogate import Surrogate
from pgdl_lab.surrogate.viewer import page, polynomial
from tests.conftest import Lab
from tests.needs import need
from tests.surrogate.browser import browser
from tests.test_surrogate import trained
from tests.trainings import small, training


@pytest.fixture(scope="module")
def surrogate(tmp_path_factory: pytest.TempPathFactory) -> Surrogate:
    model = plugin("model", "finite_element")(degree=6)
    fitted: Surrogate = model.fit(training(tmp_path_factory.mktemp("run"), {"data": {}}))
    return fitted


@pytest.fixture(scope="module")
def window(surrogate: Surrogate, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    need("chromium", "chromedriver")
    folder = tmp_path_factory.mktemp("page")
    path = folder / "viewer.html"
    path.write_text(page(surrogate, small(), "A </script> finger"), encoding="utf-8")
    with browser(folder) as opened:
        opened.get(path.as_uri())
        yield opened
        assert opened.get_log("browser") == []  # neither errors nor refused requests
        assert opened.execute_script("return performance.getEntriesByType('resource').length") == 0


def shown_kpa(window: Chrome) -> float:
    kpa: float = window.execute_script("return state.kpa")
    return kpa


def settled(window: Chrome) -> None:
    """Wait until what was asked for is drawn."""
    window.execute_async_script(
        "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => done()))"
    )


def set_kpa(window: Chrome, kpa: float) -> None:
    window.execute_script("slider.value = arguments[0]; slider.dispatchEvent(new Event('input'))", kpa)
    settled(window)


@pytest.mark.parametrize("kpa", [0.0, 17.3, 50.0])
def test_numbers_are_those_of_python(window: Chrome, surrogate: Surrogate, kpa: float) -> None:
    set_kpa(window, kpa)
    shown = np.array(window.execute_script("return Array.from(displacements(state.kpa))")).reshape(-1, 2)
    truth = surrogate.predict(small().domain.points_mm, kpa)
    assert np.abs(shown - truth).max() < 1e-4
    texts = re.findall(r"tip [xz]\n([−\d.]+) mm", window.find_element(By.ID, "readings").text.replace(" mm", " mm\n"))
    tip = surrogate.tip_mm + surrogate.predict([surrogate.tip_mm], kpa)[0]
    assert [float(text.replace("−", "-")) for text in texts] == pytest.approx(tip, abs=0.006)
    assert window.find_element(By.ID, "kpa").text.replace("\n", " ").startswith(f"{kpa:.1f}")


@pytest.mark.parametrize("kpa", [5.0, 40.0])
def test_pixels_are_where_and_of_the_colour_that_python_says(window: Chrome, surrogate: Surrogate, kpa: float) -> None:
    window.execute_script("change({colour: 'size', base: false, fem: false})")
    set_kpa(window, kpa)
    points = small().domain.points_mm
    inner = np.setdiff1d(np.arange(len(points)), surrogate.domain.mesh.outline[:, :2])
    u = surrogate.predict(points, kpa)
    stage = window.execute_script(
        "const box = stage.getBoundingClientRect(); return [box.x, box.y, view.scale, view.x, view.z]"
    )
    x, y, scale, origin_x, origin_z = stage
    places = points + u
    pixels = np.array(Image.open(io.BytesIO(window.get_screenshot_as_png())).convert("RGB")).astype(int)
    column = (x + origin_x + scale * places[inner, 0]).astype(int)
    row = (y + origin_z - scale * places[inner, 1]).astype(int)
    most = max(np.linalg.norm(surrogate.predict(points, each), axis=1).max() for each in [0, *small().pressures_kpa])
    size = np.linalg.norm(u[inner], axis=1) / most
    expected = 255 * matplotlib.colormaps["viridis"](size)[:, :3]
    difference = np.abs(pixels[row, column] - expected).max(axis=1)
    assert len(inner) > 50 and np.quantile(difference, 0.95) < 12, difference.max()
    ground = pixels[int(y + origin_z - scale * -60), int(x + origin_x + scale * 5)]
    assert tuple(ground) == (14, 20, 32)


def test_slider_keys_and_touch_move_the_finger(window: Chrome) -> None:
    set_kpa(window, 0)
    slider = window.find_element(By.ID, "slider")
    ActionChains(window).move_to_element(slider).click().perform()
    assert shown_kpa(window) == pytest.approx(25, abs=0.5)
    window.find_element(By.TAG_NAME, "body").send_keys(Keys.ARROW_RIGHT)
    assert shown_kpa(window) == pytest.approx(25.5, abs=0.5)
    slider.send_keys(Keys.END)
    assert shown_kpa(window) == 50
    ActionChains(window).drag_and_drop_by_offset(window.find_element(By.ID, "stage"), -300, 0).perform()
    assert 30 < shown_kpa(window) < 45
    window.find_element(By.TAG_NAME, "body").send_keys("4f")
    assert window.execute_script("return [state.colour, state.fem]") == ["error", True]
    settled(window)
    assert "surrogate − FEM" in window.find_element(By.ID, "quantity").text
    for key, colour in (("2", "x"), ("3", "z"), ("1", "size")):
        window.find_element(By.TAG_NAME, "body").send_keys(key)
        assert window.execute_script("return state.colour") == colour
    window.find_element(By.TAG_NAME, "body").send_keys("f")


def test_plays_and_pauses(window: Chrome) -> None:
    set_kpa(window, 10)
    play = window.find_element(By.ID, "play")
    play.click()
    WebDriverWait(window, 30).until(lambda _: shown_kpa(window) != 10)  # a busy machine draws its first frame late
    assert window.execute_script("return state.playing")
    play.click()
    stopped = shown_kpa(window)
    assert stopped != 10
    window.execute_async_script("setTimeout(arguments[0], 200)")
    assert shown_kpa(window) == stopped


@pytest.mark.parametrize(("width", "height"), [(360, 640), (640, 360), (820, 1180)])
def test_fits_a_phone(window: Chrome, width: int, height: int) -> None:
    screen = {"width": width, "height": height, "deviceScaleFactor": 2, "mobile": True}
    window.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    settled(window)
    assert window.execute_script("return document.documentElement.scrollWidth") <= width
    buttons, (stage, numbers, legend) = (
        window.execute_script(
            "return [...document.querySelectorAll(arguments[0])].map((e) => e.getBoundingClientRect().toJSON())", which
        )
        for which in ("button, #slider", "#stage, #numbers, #legend")
    )
    assert all(box["left"] >= 0 and box["right"] <= width and box["bottom"] <= height for box in buttons)
    assert all(box["height"] >= 30 for box in buttons)
    # the finger is large enough to be seen, and neither off the screen nor behind the numbers or the colours
    scale, x, z = window.execute_script("return [view.scale, view.x, view.z]")
    (x0, z0), (x1, z1) = window.execute_script("return data.boundsMm")
    left, right = stage["left"] + x + scale * x0, stage["left"] + x + scale * x1
    top, bottom = stage["top"] + z - scale * z1, stage["top"] + z - scale * z0
    assert right - left > 0.3 * width
    assert left > 0 and right < width and bottom < stage["bottom"]
    for box in (numbers, legend):
        assert left > box["right"] or right < box["left"] or top > box["bottom"]
    window.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    settled(window)


def test_a_network_is_shown_as_the_polynomial_nearest_to_it(tmp_path: Path) -> None:
    network = trained("mlp", tmp_path)
    coefficients, error_mm = polynomial(network, 50.0)
    assert coefficients.shape[1:] == small().domain.points_mm.shape
    assert error_mm < 1e-2


def test_task_writes_the_page(lab: Lab, small_run: Path, tmp_path: Path) -> None:
    done = lab("task=view")
    assert done.returncode == 0, done.stderr
    text = (small_run / "viewer.html").read_text(encoding="utf-8")
    assert "{{" not in text and "Finger “pneunet”" in text
    assert not re.search(r"(src|href|url)\s*[=(]\s*[\"']?(https?:)?//", text)
    client, run_id = MlflowClient(f"sqlite:///{tmp_path / 'mlflow.db'}"), (small_run / RUN_ID).read_text()
    assert Path(client.download_artifacts(run_id, "viewer.html")).read_text(encoding="utf-8") == text


def test_surrogate_alone_has_nothing_to_be_compared_with(surrogate: Surrogate, tmp_path: Path) -> None:
    need("chromium", "chromedriver")
    path = tmp_path / "notebook.html"
    path.write_text(f"<!doctype html><body>{surrogate._repr_html_()}", encoding="utf-8")
    with browser(tmp_path) as opened:
        opened.get(path.as_uri())
        opened.switch_to.frame(opened.find_element(By.TAG_NAME, "iframe"))
        high = surrogate.trained_kpa()[1]
        opened.find_element(By.CSS_SELECTOR, "#slider").send_keys(Keys.END)
        settled(opened)
        assert shown_kpa(opened) == pytest.approx(high)
        x, z = surrogate.tip_mm + surrogate.predict([surrogate.tip_mm], high)[0]
        said = opened.find_element(By.ID, "readings").text.replace("−", "-")
        assert [float(number) for number in re.findall(r"-?\d+\.\d+", said)] == pytest.approx([x, z], abs=0.006)
        opened.find_element(By.TAG_NAME, "body").send_keys("f4")  # keys of what is not there do nothing
        assert opened.execute_script("return [state.fem, state.colour]") == [False, "size"]
        shown = {button.text for button in opened.find_elements(By.TAG_NAME, "button") if button.is_displayed()}
        assert "base line" in shown and not {"FEM", "error"} & shown
        assert opened.get_log("browser") == []
