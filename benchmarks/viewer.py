"""How fluently the viewer moves in Chromium, and a picture of it.

    python benchmarks/viewer.py [RUN] [--seconds 3] [--picture docs/figures/viewer.png]

RUN is the folder of a training, of which `task=view` has written the page. In a headless Chromium without a graphics
card the slider is moved in every frame, on a desktop's and on a phone's screen and in every colour: frames per second,
of which the browser shows 60 at most, the longest time between two, and how long the page itself computes for one.
"""

import io
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image
from selenium.webdriver import Chrome

from benchmarks.common import folders, parsed, parser, skip
from benchmarks.scenes import fitted, scene, simulated
from pgdl_lab.running.folders import stored_run
from pgdl_lab.surrogate.viewer import page
from tests.needs import DEBIAN, program
from tests.surrogate.browser import browser

SCREENS = {"desktop": (1280, 720, 1), "phone": (390, 844, 2)}  # width and height in CSS pixels, and dots in each
LINE = "{:<9} {:<7} {:>10} {:>17} {:>19}"
MOVE = """
const [seconds, done] = arguments, shown = [], computed = [], own = draw;
window.draw = () => { const start = performance.now(); own(); computed.push(performance.now() - start); };
function step(now) {
  shown.push(now);
  if (now - shown[0] > 1000 * seconds) { window.draw = own; return done([shown, computed]); }
  slider.value = data.maxKpa * (1 - Math.cos((now - shown[0]) / 700)) / 2;
  slider.dispatchEvent(new Event("input"));
  requestAnimationFrame(step);
}
requestAnimationFrame(step);
"""


def main() -> None:
    """Print the table, and take the picture."""
    arguments = parser(__doc__)
    arguments.add_argument("run", nargs="?", default="runs/latest", help="folder of a training")
    arguments.add_argument("--seconds", type=float, default=3.0, help="for each measurement")
    arguments.add_argument("--picture", type=Path, help="PNG file of the page on both screens")
    given = parsed(arguments, seconds=0.2)
    for name in ("chromium", "chromedriver"):
        if program(name) is None:
            skip(name, f"Debian's {DEBIAN[name]}")
    place = small_page() if given.quick else stored_run(given.run) / "viewer.html"
    print(LINE.format("screen", "colour", "frames/s", "longest gap (ms)", "computing (ms)"))
    with tempfile.TemporaryDirectory() as folder, browser(Path(folder)) as window:
        window.set_script_timeout(given.seconds + 60)
        window.get(place.as_uri())
        pictures = []
        for screen, (width, height, dots) in SCREENS.items():
            size = {"width": width, "height": height, "deviceScaleFactor": dots, "mobile": screen == "phone"}
            window.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
            for colour in ("error", "x", "z", "size"):
                window.execute_script("change({colour: arguments[0], fem: true})", colour)
                shown, computed = window.execute_async_script(MOVE, given.seconds)
                rate = (len(shown) - 1) / (shown[-1] - shown[0]) * 1e3
                print(LINE.format(screen, colour, f"{rate:.0f}", f"{np.diff(shown).max():.0f}",
                                  "{:.1f} / {:.1f}".format(*np.percentile(computed, [50, 99]))))  # fmt: skip
            pictures.append(picture(window))
    if given.picture:
        together(pictures).save(given.picture)


def small_page() -> Path:
    """The page of a small finger."""
    made = scene("pneunet", quick=True)
    snapshots = simulated(made)
    surrogate, _ = fitted(made, snapshots, made.split.train_points(snapshots, made.seed))
    path = folders("viewer", quick=True)[1] / "viewer.html"
    path.write_text(page(surrogate, snapshots, "Finger “pneunet”"), encoding="utf-8")
    return path


def picture(window: Chrome) -> Image.Image:
    """The page at three fifths of the pressure."""
    window.execute_script("set(0.6 * data.maxKpa)")
    window.execute_async_script(
        "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => done()))"
    )
    return Image.open(io.BytesIO(window.get_screenshot_as_png())).convert("RGB")


def together(pictures: list[Image.Image]) -> Image.Image:
    """Pictures beside each other, as high as the first."""
    height, gap = pictures[0].height, 24
    scaled = [each.resize((round(each.width * height / each.height), height), Image.Resampling.LANCZOS)
              for each in pictures]  # fmt: skip
    whole = Image.new("RGB", (sum(each.width for each in scaled) + gap * (len(scaled) - 1), height), "white")
    left = 0
    for each in scaled:
        whole.paste(each, (left, 0))
        left += each.width + gap
    return whole


if __name__ == "__main__":
    main()
