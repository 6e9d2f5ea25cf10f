"""What tools say about size: symbols (nm), call graph with stack (gcc -fcallgraph-info=su), callgrind's counts."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field


def symbol_sizes(listing: str) -> dict[str, int]:
    """Function → bytes of code, from ``nm -S``."""
    sizes = {}
    for line in listing.splitlines():
        parts = line.split()
        if len(parts) == 4 and parts[2] in "tT":
            sizes[parts[3]] = int(parts[1], 16)
    return sizes


@dataclass
class CallGraph:
    """Functions of one object file with their static stack [bytes], and who calls whom; libraries are left out."""

    stack: dict[str, int] = field(default_factory=dict)
    calls: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))

    def reached(self, function: str) -> set[str]:
        """The function and everything of ours that it may call."""
        found: set[str] = set()
        waiting = [function]
        while waiting:
            name = waiting.pop()
            if name in self.stack and name not in found:
                found.add(name)
                waiting += self.calls[name]
        return found

    def depth(self, function: str) -> int:
        """Bytes of stack of the deepest chain of calls from a function."""
        if function not in self.stack:
            return 0
        return self.stack[function] + max(
            (self.depth(c) for c in self.calls[function] if c != function), default=0
        )


def call_graph(text: str) -> CallGraph:
    """Read a ``.ci`` file of gcc."""
    graph = CallGraph()
    for title, label in re.findall(r'node: \{ title: "([^"]*)" label: "([^"]*)"', text):
        stack = re.search(r"\\n(\d+) bytes \((\w+)", label)
        if stack is not None:
            graph.stack[_plain(title)] = int(stack.group(1))
    for source, target in re.findall(r'edge: \{ sourcename: "([^"]*)" targetname: "([^"]*)"', text):
        graph.calls[_plain(source)].add(_plain(target))
    return graph


def _plain(title: str) -> str:
    return title.rsplit(":", 1)[-1]


def instructions_per_call(text: str, caller_prefix: str) -> dict[str, int]:
    """Callee → instructions of one call, callees of its own included, where ``caller_prefix + name`` calls it once.

    text: the output file of ``valgrind --tool=callgrind``.
    """
    names: dict[str, str] = {}
    counts: dict[str, list[int]] = {}
    caller = callee = ""
    lines = iter(text.splitlines())
    for line in lines:
        if line.startswith(("fn=", "cfn=")):
            key, _, value = line.partition("=")
            name = _name(value, names)
            caller, callee = (name, callee) if key == "fn" else (caller, name)
        elif line.startswith("calls=") and caller.startswith(caller_prefix):
            cost = int(next(lines).split()[-1])
            entry = counts.setdefault(caller[len(caller_prefix) :], [0, 0])
            entry[0] += int(line[6:].split()[0])
            entry[1] += cost
    return {name: round(cost / calls) for name, (calls, cost) in counts.items()}


def _name(value: str, names: dict[str, str]) -> str:
    match = re.fullmatch(r"(\(\d+\))(?: (.*))?", value)
    if match is None:
        return value
    key, name = match.groups()
    if name:
        names[key] = name
    return names.get(key, "")


def totals(
    graph: CallGraph, sizes: Mapping[str, int], functions: Mapping[str, str]
) -> dict[str, dict[str, int]]:
    """Short name → code and stack [bytes] of a function with everything of ours that it calls."""
    return {
        short: {"code": sum(sizes.get(f, 0) for f in graph.reached(name)), "stack": graph.depth(name)}
        for short, name in functions.items()
        if name in graph.stack
    }
