"""Opens pages in Chromium without a display, and compares what they draw with pictures that `render` wrote.

    python3 tests/oracle/page.py PAGE.html RENDERED/colour FRAME... [--pictures FOLDER]

Chromium is driven through a pipe, by its own protocol; no package of Python is needed but Pillow and NumPy.
The page must draw every frame with at least 35 dB, ask for nothing, and say nothing in its console. With
--pictures, pictures of it at the sizes of a screen and of a phone are left in a folder, to be looked at. See
README.md beside this file.
"""

import argparse
import base64
import io
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

LEAST_DB = 35
CHROMIUM = os.environ.get("CHROMIUM", "chromium")
FLAGS = ["--headless=new", "--no-sandbox", "--remote-debugging-pipe", "--hide-scrollbars", "--no-first-run"]
SOFTWARE = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing"]
SIZES = {"screen": (1280, 800, 1, False), "dark": (1280, 800, 1, True), "phone": (390, 844, 2, False), "flat": (844, 390, 2, True)}


def check(is_right, what):
    if not is_right:
        sys.exit(f"wrong: {what}")


class Browser:
    """A Chromium with one page; commands go through descriptor 3, answers and events come from 4."""

    def __init__(self, profile):
        (their_in, self.out), (self.back, their_out) = os.pipe(), os.pipe()
        ends = {3: os.dup(their_in), 4: os.dup(their_out)}
        command = f"exec {CHROMIUM} {' '.join(FLAGS + SOFTWARE)} --user-data-dir={profile} 3<&{ends[3]} 4>&{ends[4]}"
        self.process = subprocess.Popen(
            ["bash", "-c", command], pass_fds=list(ends.values()), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        for end in [their_in, their_out, *ends.values()]:
            os.close(end)
        self.number, self.buffer, self.events, self.session = 0, b"", [], None
        page = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        for domain in ["Page", "Runtime", "Network", "Log"]:
            self.call(f"{domain}.enable")

    def message(self):
        while b"\0" not in self.buffer:
            part = os.read(self.back, 1 << 20)
            check(part, "Chromium ended")
            self.buffer += part
        text, self.buffer = self.buffer.split(b"\0", 1)
        return json.loads(text)

    def call(self, method, **params):
        self.number += 1
        request = {"id": self.number, "method": method, "params": params}
        if self.session:
            request["sessionId"] = self.session
        os.write(self.out, json.dumps(request).encode() + b"\0")
        while (answer := self.message()).get("id") != self.number:
            self.events.append(answer)
        check("error" not in answer, f"{method}: {answer.get('error')}")
        return answer["result"]

    def value(self, expression):
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        check("exceptionDetails" not in answer, f"{expression}: {answer}")
        return answer["result"].get("value")

    def wait(self, expression, what):
        for _ in range(1200):
            if self.value(expression):
                return
            time.sleep(0.05)
        self.screenshot("failed.png")
        check(False, f"{what}: {self.value('document.body.innerText')}")

    def size(self, width, height, scale, is_dark):
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=scale > 1)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if is_dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def open(self, url):
        # A blank page between, because another fragment alone loads nothing.
        self.call("Page.navigate", url="about:blank")
        self.call("Page.navigate", url=url)
        self.wait("document.body && document.body.dataset.drawn !== undefined", "the page draws nothing")

    def screenshot(self, path):
        Path(path).write_bytes(base64.b64decode(self.call("Page.captureScreenshot")["data"]))

    def press(self, key):
        for kind in ["keyDown", "keyUp"]:
            self.call("Input.dispatchKeyEvent", type=kind, key=key, text=key if kind == "keyDown" and len(key) == 1 else "")

    def drag(self, x, y):
        at = self.value("(r => [r.x + r.width / 2, r.y + r.height / 2])(document.querySelector('canvas').getBoundingClientRect())")
        for kind, (dx, dy) in [("mousePressed", (0, 0)), ("mouseMoved", (x, y)), ("mouseReleased", (x, y))]:
            self.call("Input.dispatchMouseEvent", type=kind, x=at[0] + dx, y=at[1] + dy, button="left", buttons=1, clickCount=1)

    def canvas(self):
        text = self.value("document.querySelector('canvas').toDataURL()")
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(text.split(",")[1]))).convert("RGB"), float)


def speaks(event):
    """Tells if the page says something; remarks on reading the canvas, which only this script does, are none."""
    if event["method"] == "Log.entryAdded":
        return "ReadPixels" not in event["params"]["entry"]["text"]
    return event["method"] in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown")


def psnr(a, b):
    check(a.shape == b.shape, f"pictures of {a.shape} and {b.shape}")
    return 10 * np.log10(255**2 / max(1e-9, ((a - b) ** 2).mean()))


def compare(browser, url, rendered, frames):
    """Draws frames with as many pixels as were recorded, without what prompts found."""
    worst = np.inf
    for frame in frames:
        browser.open(f"{url}#frame={frame}&recorded")
        browser.value("for (const box of document.querySelectorAll('#prompts input:checked')) box.click()")
        browser.value("new Promise(requestAnimationFrame).then(() => new Promise(requestAnimationFrame))")
        truth = np.asarray(Image.open(rendered / f"frame_{frame:06}.png").convert("RGB"), float)
        worst = min(worst, psnr(browser.canvas(), truth))
    check(worst >= LEAST_DB, f"the page draws a frame with {worst:.1f} dB")
    return worst


def play(browser, url):
    """Plays the page, stops it, steps, turns the view and turns it back."""
    browser.open(url)
    browser.press(" ")
    start, shown = time.time(), browser.value("document.body.dataset.drawn")
    browser.wait(f"document.body.dataset.drawn !== '{shown}'", "the page does not play")
    count = "(() => { let n = 0; new MutationObserver(() => n++).observe(document.body, { attributes: true }); return new Promise(f => setTimeout(() => f(n), 3000)); })()"
    speed = browser.value(count) / 3
    browser.press(" ")
    browser.press("Home")
    browser.wait("document.body.dataset.drawn === '0'", "Home does not lead to the first frame")
    browser.press("ArrowRight")
    browser.wait("document.body.dataset.drawn === '1'", "an arrow does not step")
    browser.drag(60, 20)
    browser.wait("!document.querySelector('#turned').hidden", "dragging does not turn the view")
    browser.press("r")
    browser.wait("document.querySelector('#turned').hidden", "the view is not reset")
    return speed


def look(browser, url, frame, folder):
    folder.mkdir(parents=True, exist_ok=True)
    for name, size in SIZES.items():
        browser.size(*size)
        browser.open(f"{url}#frame={frame}")
        time.sleep(2)
        browser.screenshot(folder / f"{name}.png")
    browser.size(*SIZES["screen"])
    browser.drag(90, 30)
    browser.press(" ")
    time.sleep(0.5)
    browser.screenshot(folder / "turned.png")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("page", type=Path)
    parser.add_argument("rendered", type=Path)
    parser.add_argument("frames", type=int, nargs="+")
    parser.add_argument("--pictures", type=Path)
    args = parser.parse_args()
    url = args.page.resolve().as_uri()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = Browser(profile)
        browser.size(*SIZES["screen"])
        worst = compare(browser, url, args.rendered, args.frames)
        speed = play(browser, url)
        if args.pictures:
            look(browser, url, args.frames[0], args.pictures)
        asked = [e["params"]["request"]["url"] for e in browser.events if e["method"] == "Network.requestWillBeSent"]
        others = {u.split("#")[0] for u in asked if not u.startswith("data:")} - {url, "about:blank"}
        check(not others, f"the page asks for {others}")
        said = [e for e in browser.events if speaks(e)]
        check(not said, f"the page says {said}")
        browser.call("Browser.close")
        browser.process.wait()
    print(f"{speed:.0f} frames a second, {worst:.1f} dB at worst", file=sys.stderr)
    print(f"the page draws {len(args.frames)} frames as `render` does, plays, steps and turns, and asks for nothing")


if __name__ == "__main__":
    main()
