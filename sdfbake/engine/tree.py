"""Nested tuples of arrays, flat and back: what loops carry."""

from collections.abc import Iterator
from typing import Any, TypeVar

Tree = TypeVar("Tree")


def leaves(tree: Any) -> list[Any]:
    """Return the arrays of nested tuples, in order."""
    if isinstance(tree, tuple):
        return [leaf for branch in tree for leaf in leaves(branch)]
    return [tree]


def rebuild(tree: Tree, values: list[Any]) -> Tree:
    """Return a tree of the same form (named tuples included) around other arrays."""
    source = iter(values)
    built: Tree = _fill(tree, source)
    return built


def _fill(tree: Any, source: Iterator[Any]) -> Any:
    if not isinstance(tree, tuple):
        return next(source)
    branches = [_fill(branch, source) for branch in tree]
    # A named tuple takes its fields one by one.
    return tuple(branches) if type(tree) is tuple else type(tree)(*branches)
