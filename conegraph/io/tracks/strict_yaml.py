"""YAML without its surprises: every scalar is text, and nothing is hidden.

PyYAML by default reads ``1e-3`` as text and ``no`` as False, and lets a repeated
key win silently; an alias can unfold a small file to fill the memory. Here
scalars stay text, and repeated keys and aliases are refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from conegraph.errors import FileFormatError
from conegraph.io.csv_table import parse_numbers

MAX_YAML_BYTES = 2 * 2**20
"""A track of 300 cones takes 20 kB; this much takes some seconds to parse."""


class _StrictLoader(yaml.BaseLoader):
    """Loads mappings, sequences and text."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.MarkedYAMLError(
                problem="aliases are refused", problem_mark=self.get_mark()
            )
        node: yaml.Node | None = super().compose_node(parent, index)
        return node

    def construct_mapping(
        self, node: yaml.MappingNode, deep: bool = False
    ) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"key {key.value!r} occurs twice",
                    problem_mark=key.start_mark,
                )
            if isinstance(key, yaml.ScalarNode):
                seen.add(key.value)
        return super().construct_mapping(node, deep=deep)


def parse_yaml(path: Path, text: str) -> object:
    """Return the document: dicts, lists and texts; an empty value is "".

    Args:
        path: named in errors.
        text: the content of the file.

    Raises:
        FileFormatError: too large or too deep, not YAML, a repeated key, an alias.
    """
    if len(text) > MAX_YAML_BYTES:
        raise FileFormatError(path, f"is larger than {MAX_YAML_BYTES >> 20} MiB")
    try:
        document: object = yaml.load(text, Loader=_StrictLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        reason = f"is not YAML that can be used: {error.problem}"
        line = None if mark is None else mark.line + 1
        raise FileFormatError(path, reason, line=line) from error
    except (yaml.YAMLError, RecursionError) as error:
        reason = f"is not YAML that can be used: {str(error)[:80]}"
        raise FileFormatError(path, reason) from error
    return document


def numbers(value: object, count: int) -> list[float] | None:
    """Return the first ``count`` numbers of a list, None if it has not as many."""
    if not isinstance(value, list) or len(value) < count:
        return None
    return parse_numbers(v if isinstance(v, str) else "" for v in value[:count])


def items(value: object) -> list[Any]:
    """Return a list, and an empty one for anything else."""
    return value if isinstance(value, list) else []
