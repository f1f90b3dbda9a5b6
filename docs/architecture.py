"""Draws the picture of ARCHITECTURE.md, docs/images/architecture.svg, from the imports: `python docs/architecture.py`.

An arrow from a package to another says that it imports it when it runs. Arrows that follow from others (A imports B, B
imports C, and A imports C too) are left out; of a circle, the arrow of the fewest imports is dashed. Small modules at
the top of `imuarray` (errors, units, axes, ...) are used by everybody and are not drawn.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from html import escape
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
BOX = (132, 34)
STEP = (158, 86)
COLOURS = {"firmware_emulator": "#fdebd0", "studies": "#eaeaea", "validation": "#eaeaea", "commands": "#dcecf9"}

Graph = dict[str, set[str]]
Weights = dict[tuple[str, str], int]


def packages() -> list[str]:
    """The packages of the repository: those directly in `imuarray`, and the emulator."""
    inside = (path.parent.name for path in (ROOT / "imuarray").glob("*/__init__.py"))
    return [*sorted(name for name in inside if name != "configs"), "firmware_emulator"]


def imports() -> Weights:
    """Count the imports that lead from one package to another, at any place of its modules, but for type checkers."""
    weights: Weights = {}
    names = packages()
    for name in names:
        folder = ROOT / name if name == "firmware_emulator" else ROOT / "imuarray" / name
        for path in sorted(folder.rglob("*.py")):
            for module in _imported(ast.parse(path.read_text(encoding="utf-8"))):
                first, _, rest = module.partition(".")
                other = rest.partition(".")[0] if first == "imuarray" else first
                if other in names and other != name:
                    weights[name, other] = weights.get((name, other), 0) + 1
    return weights


def directed(weights: Weights) -> tuple[Graph, set[tuple[str, str]]]:
    """A graph without circles, and the arrows that had to be left out of it: those of the fewest imports."""
    graph: Graph = {name: set() for name in packages()}
    against: set[tuple[str, str]] = set()
    for (name, other), _ in sorted(weights.items(), key=lambda item: (-item[1], item[0])):
        if name in _reachable(graph, other):
            against.add((name, other))
        else:
            graph[name].add(other)
    return graph, against


def _imported(node: ast.AST) -> Iterator[str]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and getattr(child.test, "id", "") == "TYPE_CHECKING":
            continue
        if isinstance(child, ast.Import):
            yield from (alias.name for alias in child.names)
        elif isinstance(child, ast.ImportFrom) and child.module:
            yield from (f"{child.module}.{alias.name}" for alias in child.names)
        yield from _imported(child)


def reduced(graph: Graph) -> Graph:
    """The graph without arrows that follow from others."""
    return {
        name: {other for other in below if not any(other in _reachable(graph, step) for step in below - {other})}
        for name, below in graph.items()
    }


def _reachable(graph: Graph, start: str) -> set[str]:
    seen: set[str] = set()
    waiting = list(graph[start])
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            waiting += graph[name]
    return seen


def layers(graph: Graph) -> list[list[str]]:
    """Packages by the longest way down to one that imports nothing; the top layer first."""
    depth: dict[str, int] = {}

    def of(name: str) -> int:
        if name not in depth:
            depth[name] = 1 + max((of(other) for other in graph[name]), default=-1)
        return depth[name]

    rows: list[list[str]] = [[] for _ in range(1 + max(of(name) for name in graph))]
    for name in graph:
        rows[depth[name]].append(name)
    return rows[::-1]


def picture() -> str:
    """The picture as SVG."""
    whole, against = directed(imports())
    graph = reduced(whole)
    rows, chains = _with_bends(layers(graph), graph)
    _untangle(rows, chains)
    width = max(map(len, rows)) * STEP[0]
    place = {
        name: (width * (index + 0.5) / len(row), 24 + BOX[1] / 2 + level * STEP[1])
        for level, row in enumerate(rows)
        for index, name in enumerate(row)
    }
    height = 48 + BOX[1] + (len(rows) - 1) * STEP[1]
    lines = [_path([place[name] for name in chain]) for chain in chains]
    lines += [_path([place[name], place[other]], upwards=True) for name, other in sorted(against)]
    boxes = [_box(name, *place[name]) for name in place if "#" not in name]
    style = "text{font:13px sans-serif;text-anchor:middle;dominant-baseline:central;fill:#222}"
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}">\n'
        "<title>Packages of imuarray and their imports</title>\n"
        f"<style>{style}</style>\n"
        '<defs><marker id="a" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0L8 4L0 8z" fill="#667"/></marker></defs>\n'
        f'<rect width="{width}" height="{height}" fill="#fff"/>\n'
    )
    return head + "\n".join([*lines, *boxes]) + "\n</svg>\n"


def _with_bends(rows: list[list[str]], graph: Graph) -> tuple[list[list[str]], list[list[str]]]:
    """Rows with a bend wherever an arrow passes through one, and every arrow as the chain of what it passes."""
    level = {name: index for index, row in enumerate(rows) for name in row}
    chains = []
    for name in sorted(graph):
        for other in sorted(graph[name]):
            bends = [f"{name}#{other}#{index}" for index in range(level[name] + 1, level[other])]
            for index, bend in enumerate(bends, start=level[name] + 1):
                rows[index].append(bend)
            chains.append([name, *bends, other])
    return rows, chains


def _untangle(rows: list[list[str]], chains: list[list[str]]) -> None:
    """Order each row by the mean place of its neighbours, up and down a few times."""
    near: dict[str, list[str]] = {name: [] for row in rows for name in row}
    for chain in chains:
        for upper, lower in pairwise(chain):
            near[upper].append(lower)
            near[lower].append(upper)
    for _ in range(12):
        for order in (rows, rows[::-1]):
            place = {name: (index + 0.5) / len(row) for row in rows for index, name in enumerate(row)}
            for row in order:
                row.sort(key=lambda name: sum(place[other] for other in near[name]) / max(1, len(near[name])))
                place |= {name: (index + 0.5) / len(row) for index, name in enumerate(row)}


def _path(points: list[tuple[float, float]], *, upwards: bool = False) -> str:
    (x, y), *middle, (last_x, last_y) = points
    half = -BOX[1] / 2 if upwards else BOX[1] / 2
    y, last_y = y + half, last_y - half
    text = f"M{x:.0f} {y:.0f}"
    for next_x, next_y in [*middle, (last_x, last_y)]:
        bend = (y + next_y) / 2
        text += f"C{x:.0f} {bend:.0f} {next_x:.0f} {bend:.0f} {next_x:.0f} {next_y:.0f}"
        x, y = next_x, next_y
    dashes = ' stroke-dasharray="4 4"' if upwards else ""
    return f'<path d="{text}" fill="none" stroke="#667" stroke-width="1.3"{dashes} marker-end="url(#a)"/>'


def _box(name: str, x: float, y: float) -> str:
    corner = f'x="{x - BOX[0] / 2:.0f}" y="{y - BOX[1] / 2:.0f}" width="{BOX[0]}" height="{BOX[1]}"'
    colour = COLOURS.get(name, "#eef4ea")
    return f'<rect {corner} rx="5" fill="{colour}" stroke="#556"/><text x="{x:.0f}" y="{y:.0f}">{escape(name)}</text>'


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
