#!/usr/bin/env python3
"""Prints the licences of everything that is built into the program: names, versions, expressions and texts.

Reads what cargo has fetched; fails where a package names no licence.
"""

import json
import pathlib
import subprocess
import sys

NAMES = ("licen", "copying", "notice", "unlicense")


def shipped(metadata: dict) -> set[str]:
    """Ids of the packages that the program is linked from, without those for building and testing."""
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    root = next(p["id"] for p in metadata["packages"] if p["name"] == "surgtpgs")
    found, waiting = set(), [root]
    while waiting:
        package = waiting.pop()
        if package in found:
            continue
        found.add(package)
        for dependency in nodes[package]["deps"]:
            if any(kind["kind"] is None for kind in dependency["dep_kinds"]):
                waiting.append(dependency["pkg"])
    return found


def texts(package: dict) -> list[str]:
    folder = pathlib.Path(package["manifest_path"]).parent
    files = sorted(f for f in folder.iterdir() if f.is_file() and f.name.lower().startswith(NAMES))
    return [f.read_text(encoding="utf-8", errors="replace").strip() for f in files]


def main() -> None:
    host = next(
        line.removeprefix("host: ")
        for line in subprocess.run(["rustc", "-vV"], check=True, capture_output=True, text=True).stdout.splitlines()
        if line.startswith("host: ")
    )
    command = ["cargo", "metadata", "--format-version", "1", "--locked", "--filter-platform", host]
    metadata = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    ids = shipped(metadata)
    packages = sorted((p for p in metadata["packages"] if p["id"] in ids), key=lambda p: (p["name"], p["version"]))
    without = [p["name"] for p in packages if not (p["license"] or p["license_file"])]
    if without:
        sys.exit(f"no licence is named by: {', '.join(without)}")
    by_text: dict[str, list[str]] = {}
    for package in packages:
        label = f"{package['name']} {package['version']}"
        print(f"{label}: {package['license'] or package['license_file']}")
        for text in texts(package):
            by_text.setdefault(text, []).append(label)
    for text, labels in by_text.items():
        print(f"\n{'=' * 80}\n{', '.join(labels)}\n{'=' * 80}\n{text}")


main()
