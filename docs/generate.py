"""Reference pages generated from the code: a MkDocs hook, and a program.

`python docs/generate.py DIR` writes the pages as Markdown files into DIR. As a hook of `mkdocs build` they are added to
the site without being written anywhere, together with the pages at the root of the repository (ARCHITECTURE.md, ...).
"""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from html import escape
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import click
from pydantic import BaseModel

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(Path(__file__).parent))  # for the module beside this one; a hook has another path later on

from reference_pictures import EXAMPLES, PROBE_EXAMPLES, TECHNIQUE_EXAMPLES, pictures  # noqa: E402

ROOT_PAGES = ("ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md", "VALIDATION.md")
"""Pages at the root of the repository that are part of the site, under their names in lower case."""

PYTHON_MODULES = (
    "imuarray", "imuarray.log", "imuarray.calibrate", "imuarray.characterise", "imuarray.fuse", "imuarray.gap.diagnose",
    "imuarray.gap.findings.diagnosis",
    "imuarray.simulate", "imuarray.acquire", "imuarray.bus", "imuarray.report", "imuarray.errors",
)  # fmt: skip

Pages = dict[str, str]


def pages() -> Pages:
    """Every generated page: its path below docs/, and its Markdown."""
    made: Pages = {}
    for make in (_commands, _configuration, _chips, _effects, _causes, _probes, _techniques, _mechanisms, _python):
        made |= make()
    return made


# Commands ------------------------------------------------------------------------------------------------------------


def _commands() -> Pages:
    from imuarray.cli import COMMANDS, program

    context = click.Context(program, info_name="imuarray")
    made = {
        "reference/commands/index.md": _index(
            "Commands", [(f"imuarray {n}", f"{n}.md", t) for n, t in COMMANDS.items()]
        )
    }
    for name in COMMANDS:
        command = program.get_command(context, name)
        assert command is not None, name  # noqa: S101  every name of the table is a command
        made[f"reference/commands/{name}.md"] = "\n".join(_command(command, f"imuarray {name}", context))
    return made


def _command(command: click.Command, words: str, parent: click.Context, level: int = 1) -> Iterator[str]:
    context = click.Context(command, info_name=words.rpartition(" ")[2], parent=parent)
    yield f"{'#' * level} {words}\n"
    usage = " ".join(command.collect_usage_pieces(context))
    yield f"```text\n{words} {usage}\n```\n"
    yield _help_text(command.help or "")
    options = [parameter for parameter in command.get_params(context) if isinstance(parameter, click.Option)]
    rows = [option.get_help_record(context) for option in options if not option.hidden]
    if rows:
        yield _table(("option", "meaning"), [(f"`{row[0]}`", row[1]) for row in rows if row])
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            if below is not None:
                yield from _command(below, f"{words} {name}", context, level + 1)


def _help_text(text: str) -> str:
    """Paragraphs of a help text; examples, which click marks with a backspace, as code blocks."""
    parts = []
    for part in re.split(r"\n\s*\n", inspect.cleandoc(text)):
        lines = part.splitlines()
        if lines and lines[0] == "\b":
            parts.append("```text\n" + "\n".join(lines[1:]) + "\n```")
        else:
            parts.append(_escaped(part))
    return "\n\n".join(parts) + "\n"


# Configuration -------------------------------------------------------------------------------------------------------


def _configuration() -> Pages:
    from imuarray import array
    from imuarray.importers import mapping
    from imuarray.simulate import model

    text = ["# Configuration keys\n"]
    for title, module, shown in (
        ("The array", array, "configs/martin2013.toml is an example."),
        ("The map of an import", mapping, "configs/import_example.toml explains every key by an example."),
        ("The model of the simulator", model, "configs/models has examples; the keys of an effect are on its page."),
    ):
        text += [f"## {title}\n", f"{shown}\n"]
        for kind in _schemas(module):
            text += [f"### `{kind.__name__.lstrip('_')}`\n", _docstring(kind), _fields_of_schema(kind)]
    return {"reference/configuration.md": "\n".join(text)}


def _schemas(module: Any) -> list[type[BaseModel]]:
    """The schemas that a module defines whose fields are keys of a file, in its order."""
    kinds = [kind for kind in vars(module).values() if isinstance(kind, type) and issubclass(kind, BaseModel)]
    return [kind for kind in kinds if kind.__module__ == module.__name__ and kind.model_config.get("extra") == "forbid"]


def _fields_of_schema(kind: type[BaseModel]) -> str:
    notes = _attribute_docstrings(kind)
    rows = []
    for name, field in kind.model_fields.items():
        default = "required" if field.is_required() else _toml_text(field.get_default(call_default_factory=True))
        meaning = _one_line(notes.get(name, "")).replace("None:", "not set:")
        rows.append((f"`{field.alias or name}`", _type_name(field.annotation), default, meaning))
    return _table(("key", "type", "default", "meaning"), rows)


def _toml_text(value: Any) -> str:
    """A default as a file would state it; "not set" for None and for a table, which TOML files omit."""
    return "not set" if value is None or isinstance(value, BaseModel) else f"`{json.dumps(value, ensure_ascii=False)}`"


def _type_name(kind: Any) -> str:
    """A type as a person would write it: `list of number`, `text`, `one of 'a', 'b'`."""
    plain = {str: "text", int: "whole number", float: "number", bool: "true or false"}
    if kind in plain:
        return plain[kind]
    origin, inside = get_origin(kind), get_args(kind)
    if origin is Literal:
        return "one of " + ", ".join(f"`{json.dumps(value, ensure_ascii=False)}`" for value in inside)
    if origin is Annotated:
        return _type_name(inside[0])
    if origin in (list, tuple, set, frozenset):
        return f"list of {_type_name(inside[0])}" if inside else "list"
    if origin in (dict, Mapping):
        return "table"
    if inside:
        return " or ".join(_type_name(part) for part in inside if part is not type(None))
    return f"table `{kind.__name__.lstrip('_')}`" if isinstance(kind, type) else "any"


# Registries ----------------------------------------------------------------------------------------------------------


def _chips() -> Pages:
    from imuarray.chips import CHIPS, die_of

    rows, made = [], {}
    tables = {"hmc5883l": "hmc5883", "mpu9250": "mpu6500"}  # parts of which two share a table
    for name, spec in CHIPS.items():
        facts = importlib.import_module(f"imuarray.facts.{tables.get(die_of(name), die_of(name))}")
        first = _first_paragraph(facts.__doc__ or "")
        rows.append((name, f"{name}.md", first))
        settings = [
            ("quantity", spec.quantity.replace("_", " ")),
            ("addresses", ", ".join(f"{address:#04x}" for address in spec.addresses)),
            (
                "ranges, counts per unit",
                "; ".join(f"±{r:g} {spec.unit}: {s:.6g}" for r, s in spec.sensitivity.items()) or "-",
            ),
            ("data rates in Hz", ", ".join(f"{rate:g}" for rate in spec.rates_hz) or f"{spec.fixed_rate_hz:g}, fixed"),
            ("bandwidths in Hz", "; ".join(_bandwidths(*item) for item in spec.bandwidths_hz.items()) or "-"),
            ("queue (FIFO)", "yes" if spec.has_fifo else "no"),
            ("thermometer", "yes" if spec.has_thermometer else "no"),
        ]
        text = [
            f"# Chip `{name}`\n",
            _escaped(inspect.cleandoc(facts.__doc__ or "")) + "\n",
            "## Settings\n",
            _table(("", ""), settings),
            f"![{name}: readings at rest](../../images/chips/{name}.svg)\n",
            "Readings of one simulated chip at rest, by its data sheet, less their mean, and their distribution. A chip"
            " whose data sheet states no noise repeats one code.\n",
        ]
        made[f"reference/chips/{name}.md"] = "\n".join([*text, "## Registers\n", _registers(facts)])
    return {"reference/chips/index.md": _index("Chips", rows), **made}


def _bandwidths(rate_hz: float, allowed: Sequence[float]) -> str:
    values = ", ".join(f"{value:g}" for value in allowed)
    return f"at {rate_hz:g} Hz: {values}" if rate_hz else values


def _registers(facts: Any) -> str:
    from imuarray.facts.registers import Field, Register

    named = [(name, value) for name, value in vars(facts).items() if isinstance(value, Register)]
    rows = []
    for name, register in sorted(named, key=lambda pair: (pair[1].bank, pair[1].address)):
        bits = [
            f"{other} [{value.high}{f':{value.low}' if value.low != value.high else ''}]"
            for other, value in vars(facts).items()
            if isinstance(value, Field) and value.register == register
        ]
        place = f"{register.address:#04x}" + (f" of bank {register.bank}" if register.bank else "")
        rows.append((place, f"`{name}`", register.access, f"{register.reset:#04x}", ", ".join(bits)))
    return _table(("address", "register", "access", "reset", "fields [bits]"), rows)


def _effects() -> Pages:
    from imuarray.gap.inference.effects import CANDIDATES
    from imuarray.simulate.effects import EFFECTS

    rows, made = [], {}
    for name, kind in EFFECTS.items():
        headline = f"{kind.meaning}."
        rows.append((name, f"{name}.md", headline))
        text = [
            f"# Effect `{name}`\n",
            f"{_sentence(headline)}\n",
            _docstring(kind),
            "## Parameters\n",
            _parameters(kind),
            "`spans` limits the effect to stretches of time: three numbers for each, the number of a run, and the"
            " beginning and the end in it in seconds. Without any, the effect always acts.\n",
        ]
        if name in EXAMPLES:
            text.append(_picture(name))
        if name in CANDIDATES:
            text.append(f"The diagnosis looks for it as a [cause](../causes/{name}.md).\n")
        made[f"reference/effects/{name}.md"] = "\n".join(text)
    return {"reference/effects/index.md": _index("Effects of the simulator", rows), **made}


def _picture(effect: str) -> str:
    """The picture of an effect of `EXAMPLES`, with its caption."""
    return (
        f"![{effect}: the readings of a sensor with and without it](../../images/effects/{effect}.svg)\n\n"
        f"{EXAMPLES[effect].caption} Blue: with the effect; grey: without.\n"
    )


def _parameters(kind: Any) -> str:
    """The parameters of an effect, as a model file spells them; UNIT stands for the sensor's unit."""
    from imuarray.simulate.effect import UNBOUNDED

    rows = []
    for item in fields(kind):
        spelled = item.name + str(item.metadata.get("suffix", "")).replace("{u}", "UNIT")
        default = item.default
        per_axis = bool(item.metadata.get("per_axis"))
        value = default[0] if isinstance(default, tuple) and per_axis else default
        low, high = item.metadata.get("allowed", UNBOUNDED)
        allowed = "" if (low, high) == UNBOUNDED else f"from {low:g}" + (f" to {high:g}" if isfinite(high) else "")
        rows.append((f"`{spelled}`", "one per axis" if per_axis else "one", f"`{value!r}`", allowed))
    return _table(("key", "values", "default (no effect)", "allowed"), rows)


def _causes() -> Pages:
    from imuarray.gap.inference.effects import CANDIDATES
    from imuarray.gap.statistics.probes import PROBES

    rows, made = [], {}
    for name, candidate in CANDIDATES.items():
        headline = f"Recognised by {candidate.about}."
        rows.append((name, f"{name}.md", headline))
        seen = [
            f"[`{probe}`](../probes/{value.domain}.md)" for probe, value in PROBES.items() if name in value.moved_by
        ]
        text = [
            f"# Cause `{name}`\n",
            f"{_sentence(headline)}\n",
            _docstring(candidate.suggestions),
            f"Model: the effect [`{name}`](../effects/{name}.md).\n",
            "Probes that were made to see it: " + (", ".join(seen) or "none of its own") + ".\n",
        ]
        if name in EXAMPLES:
            text.append(_picture(name))
        made[f"reference/causes/{name}.md"] = "\n".join(text)
    return {"reference/causes/index.md": _index("Causes that the diagnosis knows", rows), **made}


def _probes() -> Pages:
    from imuarray.gap.statistics.probes import PROBES, Domain

    rows, made = [], {}
    for domain in get_args(Domain):
        module = importlib.import_module(f"imuarray.gap.statistics.probes.{domain}")
        members = [(name, probe) for name, probe in PROBES.items() if probe.domain == domain]
        rows.append((domain, f"{domain}.md", f"{_headline(module)} ({len(members)} probes)"))
        table = [
            (
                f"`{name}`",
                _escaped(probe.about),
                _escaped(probe.unit.replace("{u}", "UNIT")) or "-",
                ", ".join(f"`{e}`" for e in probe.moved_by),
            )
            for name, probe in members
        ]
        text = [
            f"# Probes of the domain `{domain}`\n",
            _docstring(module),
            f"![{domain}: what its probes measure](../../images/probes/{domain}.svg)\n",
            f"{PROBE_EXAMPLES[domain].caption} Blue: with the effect; grey: without.\n",
            "UNIT is the sensor's unit.\n",
        ]
        made[f"reference/probes/{domain}.md"] = "\n".join(
            [*text, _table(("probe", "measures", "unit", "made to see"), table)]
        )
    return {"reference/probes/index.md": _index("Probes, by domain", rows), **made}


def _techniques() -> Pages:
    from imuarray.fuse.technique_descriptions import TECHNIQUE_DESCRIPTIONS
    from imuarray.fuse.techniques import NEEDS_NOISE

    rows, made = [], {}
    for name in _technique_names():
        module = importlib.import_module(_technique_module(name))
        about = TECHNIQUE_DESCRIPTIONS[name].about
        rows.append((name, f"{name}.md", about))
        text = [f"# Technique `{name}`\n", f"{_sentence(about)}.\n"]
        needs = (
            "a calibration with `calibrate noise`"
            if name in NEEDS_NOISE or name == "optimal"
            else "nothing; better with a calibration"
        )
        text += [
            f"Needs: {needs}.\n",
            f"![{name}: its result beside those of single sensors](../../images/techniques/{name}.svg)\n",
            f"{TECHNIQUE_EXAMPLES[name].caption} Simulated; blue: `{name}`; grey: single sensors"
            f"{'' if name == 'mean' else '; red: `mean`'}.\n",
        ]
        text += ["## As the code describes it\n", _docstring(module)]
        made[f"reference/techniques/{name}.md"] = "\n".join(text)
    return {"reference/techniques/index.md": _index("Techniques of fusion", rows), **made}


def _technique_names() -> tuple[str, ...]:
    from imuarray.fuse.fusion import NAMES

    return tuple(NAMES)


def _technique_module(name: str) -> str:
    return {"mean": "imuarray.fuse.least_squares", "optimal": "imuarray.fuse.optimal.optimal"}.get(
        name, f"imuarray.fuse.techniques.{name}"
    )


def _mechanisms() -> Pages:
    from firmware_emulator.mechanisms import MECHANISMS

    text = ["# Mechanisms of the emulator\n", _docstring(importlib.import_module("firmware_emulator.mechanisms"))]
    for name, kind in MECHANISMS.items():
        text += [f"## `{name}`\n", _docstring(kind)]
    return {"reference/mechanisms.md": "\n".join(text)}


# Python --------------------------------------------------------------------------------------------------------------


def _python() -> Pages:
    made: Pages = {}
    rows = []
    for name in PYTHON_MODULES:
        module = importlib.import_module(name)
        rows.append((name, f"{name}.md", _first_paragraph(module.__doc__ or "")))
        made[f"reference/python/{name}.md"] = "\n".join(_module(module))
    return {"reference/python/index.md": _index("Python interface", rows), **made}


def _module(module: Any) -> Iterator[str]:
    yield f"# `{module.__name__}`\n"
    yield _docstring(module)
    for name in _public(module):
        value = getattr(module, name)
        if inspect.isclass(value):
            yield f"## class `{name}`\n"
            yield _docstring(value)
            if is_dataclass(value):
                yield _table(
                    ("field", "type"), [(f"`{item.name}`", f"`{_short(str(item.type))}`") for item in fields(value)]
                )
            for method, function in _methods(value):
                yield f"### `{name}.{method}`\n"
                if callable(function):
                    yield f"```python\n{method}{_signature(function)}\n```\n"
                yield _docstring(function)
        elif callable(value):
            yield f"## `{name}`\n"
            yield f"```python\n{name}{_signature(value)}\n```\n"
            yield _docstring(value)


def _public(module: Any) -> list[str]:
    names = getattr(module, "__all__", None)
    if names is None:
        names = [name for name, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__]
    return [name for name in names if not name.startswith("_")]


def _methods(kind: type) -> list[tuple[str, Any]]:
    """Methods and properties that a class itself defines and documents."""
    documented = []
    for name, value in vars(kind).items():
        function = value.fget if isinstance(value, property) else getattr(value, "__func__", value)
        if not name.startswith("_") and inspect.isfunction(function) and function.__doc__:
            documented.append((name, value if isinstance(value, property) else function))
    return documented


def _signature(function: Callable[..., Any]) -> str:
    try:
        return _short(str(inspect.signature(function)))
    except (TypeError, ValueError):
        return "(...)"


def _short(text: str) -> str:
    return re.sub(r"\b(?:imuarray|collections|typing|numpy|pathlib|os)\.(?:[a-z_]+\.)*", "", text).replace("'", "")


# Text ----------------------------------------------------------------------------------------------------------------


def _docstring(value: Any) -> str:
    """A docstring as Markdown: examples and indented pictures as code blocks, words escaped."""
    parts: list[str] = []
    for part in re.split(r"\n[ \t]*\n", inspect.cleandoc(getattr(value, "__doc__", None) or "")):
        if part.lstrip().startswith(">>>"):
            parts.append("```python\n" + textwrap.dedent(part) + "\n```")
        elif part.startswith("    "):
            parts.append("```text\n" + textwrap.dedent(part) + "\n```")
        elif part.strip() != "::":
            parts.append(_escaped(re.sub(r"::$", ":", part)))
    return "\n\n".join(parts) + "\n"


def _escaped(text: str) -> str:
    """Escape what Markdown would take for markup, outside of `code`."""
    pieces = re.split(r"(``?[^`]+``?)", text)
    return "".join(piece if piece.startswith("`") else re.sub(r"([*_<>\[\]|])", r"\\\1", piece) for piece in pieces)


def _attribute_docstrings(kind: type) -> dict[str, str]:
    """The string that follows a field in the source of its class."""
    try:
        body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    except OSError:  # a class that was made by a call
        return {}
    statements = body.body if isinstance(body, ast.ClassDef) else []
    return {
        before.target.id: after.value.value
        for before, after in pairwise(statements)
        if isinstance(before, ast.AnnAssign) and isinstance(before.target, ast.Name)
        and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(after.value.value, str)
    }  # fmt: skip


def _headline(module: Any) -> str:
    """The first paragraph of a docstring without the name that it begins with."""
    return re.sub(r"^`\w+`: ", "", _first_paragraph(module.__doc__ or ""))


def _first_paragraph(text: str) -> str:
    return _one_line(inspect.cleandoc(text).split("\n\n")[0])


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _sentence(text: str) -> str:
    return _escaped(text[:1].upper() + text[1:])


def _index(title: str, rows: Sequence[tuple[str, str, str]]) -> str:
    table = _table(("name", ""), [(f"[`{name}`]({link})", _escaped(text)) for name, link, text in rows])
    return f"# {title}\n\n{table}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(map(_cell, cells)) + " |"

    return "\n".join([line(head), "|" + "---|" * len(head), *map(line, rows)]) + "\n"


def _cell(text: str) -> str:
    """One cell of a table: on one line, without the character that ends a cell."""
    plain = re.sub(r"`([^`]*[|][^`]*)`", lambda match: f"<code>{escape(match[1])}</code>", " ".join(text.split()))
    return plain.replace("\\|", "&#124;").replace("|", "&#124;")


# The hook ------------------------------------------------------------------------------------------------------------

_GENERATED: Pages = {}
_SECTIONS = {
    "Commands": "commands", "Configuration keys": "configuration.md", "Python interface": "python", "Chips": "chips",
    "Effects": "effects", "Causes": "causes", "Probes": "probes", "Techniques": "techniques",
    "Mechanisms of the emulator": "mechanisms.md",
}  # fmt: skip


def on_config(config: Any) -> Any:
    """Add the generated pages to the navigation, under "Reference"."""
    _GENERATED.update(pages())
    reference = next(part["Reference"] for part in config.nav if "Reference" in part)
    for title, name in _SECTIONS.items():
        if name.endswith(".md"):
            reference.append({title: f"reference/{name}"})
        else:
            paths = [path for path in _GENERATED if path.startswith(f"reference/{name}/")]
            reference.append(
                {title: [path if path.endswith("index.md") else {Path(path).stem: path} for path in paths]}
            )
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the generated pages and those of the repository's root to the site."""
    from mkdocs.structure.files import File

    root = {name.lower(): _root_page(name) for name in ROOT_PAGES}
    for path, text in {**_GENERATED, **root}.items():
        files.append(File.generated(config, path, content=text))
    for path, drawn in pictures():
        files.append(File.generated(config, f"images/{path}", content=drawn))
    return files


def _root_page(name: str) -> str:
    """A page of the repository's root, with its links as they are inside docs/."""
    text = (ROOT / name).read_text(encoding="utf-8")
    text = re.sub(r"\]\((?!https?:)docs/", "](", text)
    return re.sub(r"\]\(([A-Z]+)\.md", lambda match: f"]({match[1].lower()}.md", text)


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Links out of docs/ lead to the page on the site, or are names of files; marks of tested code blocks go."""
    text = re.sub(r"^( *```\w+) \w+$", r"\1", markdown, flags=re.MULTILINE)
    here = Path(page.file.src_uri).parent
    depth = len(here.parts)

    def inside(match: re.Match[str]) -> str:
        label, target = match[1], match[2]
        up = re.match(r"(?:\.\./)*", target)
        outside = up is not None and len(up[0]) // 3 > depth
        if re.match(r"[a-z]+:|#", target) or not (outside or target.startswith(("tests/", "configs/", "imuarray/"))):
            return match[0]
        name = target.rpartition("../")[2]
        if name in ROOT_PAGES:
            return f"[{label}]({'../' * depth}{name.lower()})"
        return label if label.startswith("`") else f"`{name}`"

    return re.sub(r"(?<!!)\[([^\]]+)\]\(([^)\s]+)\)", inside, text)


def main(folder: Path) -> None:
    """Write every generated page and picture below `folder`."""
    for path, text in pages().items():
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")
    for path, drawn in pictures():
        target = folder / "images" / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(drawn)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python docs/generate.py DIR")
    main(Path(sys.argv[1]))
