"""From a validation error to one sentence that says what to mend."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from difflib import SequenceMatcher

from pydantic import ValidationError

from conegraph.config.detector import DETECTORS
from conegraph.config.models import BACKENDS, Config
from conegraph.config.section import Section

_CHOICES = {"backend": BACKENDS, "detector": DETECTORS}
"""The sections that are a choice of several, by their tags."""
_SECTION_WEIGHT = 0.25
_ALIKE, _PART = 0.6, 0.9
"""Likeness from which on two names mean the same, and of a name to a part of it."""
_SHOWN = 80


def explain(error: ValidationError) -> str:
    """Return the first problem as ``dotted.key: what is wrong``.

    An unknown key comes with the nearest valid key of the whole schema, and a key
    that another back end or detector has is named as that one's.
    """
    first = error.errors(include_url=False)[0]
    path = [str(part) for part in first["loc"]]
    # Pydantic puts the union's tag into the path; no file has it there.
    choices = _CHOICES.get(path[0], {})
    tagged = len(path) > 1 and path[1] in choices
    kind = path.pop(1) if tagged else None
    value = first["input"]
    if first["type"] == "extra_forbidden":
        return _explain_unknown_key(path, value, kind)
    if first["type"] == "union_tag_invalid":
        found = first["ctx"]["tag"]
        return f"{path[0]}.kind: {found!r} is none of {', '.join(choices)}"
    dotted = ".".join(path)
    if first["type"].startswith("model_") or dotted in _CHOICES:
        return f"{dotted} is a section of keys, not a value (got {_short(value)})"
    return f"{dotted}: {first['msg']} (got {_short(value)})"


def key_paths() -> dict[str, str]:
    """Return every valid dotted key with the sentence that describes it."""
    return dict(_walk(Config, ""))


def nearest_key(dotted: str) -> str:
    """Return the valid dotted key most like the given one.

    A key of its own section that is like it comes first, unless another section has
    it by the very name; a key filed under the wrong section is found where it belongs.
    Where nothing is like it, one of its own section is returned.
    """
    section, _, name = dotted.rpartition(".")

    def alike(key: str) -> float:
        key_name = key.rpartition(".")[2]
        part = f"_{name}_" in f"_{key_name}_"
        likeness = SequenceMatcher(None, name, key_name).ratio()
        return likeness if name == key_name or not part else max(likeness, _PART)

    def near(key: str) -> float:
        sections = SequenceMatcher(None, section, key.rpartition(".")[0]).ratio()
        return alike(key) + _SECTION_WEIGHT * sections

    keys = list(key_paths())
    best = max(keys, key=near)
    own = [key for key in keys if section and key.rpartition(".")[0] == section]
    if not own or alike(best) == 1.0:
        return best
    nearest = max(own, key=alike)
    return best if alike(nearest) < _ALIKE <= alike(best) else nearest


def _explain_unknown_key(path: list[str], value: object, kind: str | None) -> str:
    while isinstance(value, Mapping) and value:
        key, value = next(iter(value.items()))
        path = [*path, str(key)]
    dotted = ".".join(path)
    if kind is not None and len(path) == 2:
        choices = _CHOICES[path[0]].items()
        owners = [k for k, model in choices if path[1] in model.model_fields]
        if owners:
            return f"{dotted} belongs to {', '.join(owners)}, not to {kind}"
    return f"{dotted}: no such key; did you mean {nearest_key(dotted)}?"


def _walk(model: type[Section], prefix: str) -> Iterator[tuple[str, str]]:
    for name, field in model.model_fields.items():
        key = f"{prefix}{name}"
        if name in _CHOICES and not prefix:
            for section in _CHOICES[name].values():
                yield from _walk(section, f"{key}.")
        elif isinstance(field.default, Section):
            yield from _walk(type(field.default), f"{key}.")
        else:
            yield key, field.description or ""


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 1]}…"
