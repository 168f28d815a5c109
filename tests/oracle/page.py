"""Opens pages in Chromium without a display, and compares what they draw with pictures that `render` wrote.

    python3 tests/oracle/page.py PAGE.html RENDERED/colour FRAME... [--masks EXPORT] [--pictures FOLDER]

Chromium is driven through a pipe, by its own protocol; no package of Python is needed but Pillow and NumPy.
The page must draw every frame with at least 35 dB, ask for nothing, and say nothing in its console. With
--masks, what each of its prompts marks must be what an export as `binary` found: a mean IoU of at least 0.8.
With --pictures, pictures of it at the sizes of a screen and of a phone are left in a folder, to be looked at.
See README.md beside this file.
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

LEAST_DB, LEAST_IOU = 35, 0.8
# Share of a prompt's colour above which a pixel is marked: half of that of the page's fill.
MARKED = 0.14
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

    def switch(self, boxes):
        """Clicks boxes of prompts, given as an expression, and waits until all is drawn."""
        self.value(f"for (const box of {boxes}) box.click()")
        self.value("new Promise(requestAnimationFrame).then(() => new Promise(requestAnimationFrame))")

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


def marked(plain, drawn, colour):
    """Pixels that have some of the colour in one picture and not in the other, wherever else they are darker."""
    def across(vectors):
        """The part that is no multiple of the plain colour."""
        along = (vectors * plain).sum(-1, keepdims=True) / np.maximum(1, (plain**2).sum(-1, keepdims=True))
        return vectors - along * plain

    pure = across(np.broadcast_to(np.asarray(colour, float), plain.shape))
    has = (across(drawn) * pure).sum(-1) / np.maximum(1, (pure**2).sum(-1)) > MARKED
    # The outer half of the contour lies around what was found, but for the border of the recorded picture.
    wide = np.pad(has | (plain == 0).all(-1), 1, mode="edge")
    return has & wide[:-2, 1:-1] & wide[2:, 1:-1] & wide[1:-1, :-2] & wide[1:-1, 2:]


def masks_of(export):
    """Paths of an export's masks by prompt and frame."""
    files = json.loads((export / "provenance.json").read_text("utf-8"))["files"]
    return {(f["prompt"], f["frame"]): export / f["name"] for f in files if f["name"].startswith("binary/")}


def compare_marks(browser, frame, plain, masks):
    """Switches on the prompts that are found on the frame, one at a time; returns the IoU of each with its mask."""
    scene = browser.value("JSON.parse(document.getElementById('scene').textContent)")
    fits = {}
    for k, prompt in enumerate(scene["prompts"]):
        if prompt["frames"][frame - scene["first"]] != "found":
            continue
        box = f"[document.querySelectorAll('#prompts input')[{k}]]"
        browser.switch(box)
        found = marked(plain, browser.canvas(), prompt["colour"])
        browser.switch(box)
        what = f"\"{prompt['text']}\" on frame {frame}"
        check((browser.canvas() == plain).all(), f"{what} is still drawn when it is switched off")
        check((prompt["text"], frame) in masks, f"the export has no mask of {what}")
        truth = np.asarray(Image.open(masks[prompt["text"], frame])) > 0
        fits[prompt["text"]] = (found & truth).sum() / max(1, (found | truth).sum())
    return fits


def compare(browser, url, rendered, frames, masks):
    """Draws frames with as many pixels as were recorded, without what prompts found, and with one at a time."""
    worst, fits = np.inf, {}
    for frame in frames:
        browser.open(f"{url}#frame={frame}&recorded")
        browser.switch("document.querySelectorAll('#prompts input:checked')")
        truth = np.asarray(Image.open(rendered / f"frame_{frame:06}.png").convert("RGB"), float)
        plain = browser.canvas()
        worst = min(worst, psnr(plain, truth))
        if masks:
            for prompt, fit in compare_marks(browser, frame, plain, masks).items():
                fits.setdefault(prompt, []).append(fit)
    check(worst >= LEAST_DB, f"the page draws a frame with {worst:.1f} dB")
    check(fits or not masks, "no prompt of the page is found on these frames")
    fits = {prompt: np.mean(of_frames) for prompt, of_frames in fits.items()}
    for prompt, fit in fits.items():
        check(fit >= LEAST_IOU, f"the page marks \"{prompt}\" with an IoU of {fit:.2f}")
    return worst, fits


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
    parser.add_argument("--masks", type=Path)
    parser.add_argument("--pictures", type=Path)
    args = parser.parse_args()
    url = args.page.resolve().as_uri()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = Browser(profile)
        browser.size(*SIZES["screen"])
        worst, fits = compare(browser, url, args.rendered, args.frames, masks_of(args.masks) if args.masks else {})
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
    if fits:
        print(", ".join(f"{prompt}: IoU {fit:.2f}" for prompt, fit in fits.items()), file=sys.stderr)
        print(f"it marks what {len(fits)} prompts find where the export has their masks")


if __name__ == "__main__":
    main()
