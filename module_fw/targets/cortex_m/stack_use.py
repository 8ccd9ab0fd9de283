#!/usr/bin/env python3
"""How deep the stack of a linked image can get, from what the compiler wrote beside it (-fcallgraph-info=su).

    stack_use.py LIMIT_BYTES FILE.ci...

Prints the deepest path from each root. Fails (exit status 1) when it is deeper than the limit, and when the answer
would be a guess: a frame of unknown size, a recursion, an indirect call of a class that is not known here.
"""
import re
import sys
from functools import lru_cache

# Who a virtual call may end up in: by the class that calls.
INDIRECT = {
    r"3mrr3can4Node": r"^_ZNK?3mrr2fw6Module\d+(may_write|written|follows|pdo_delivered|sync|selection|refresh|nmt_changed"
                      r"|reset|heartbeat_lost|heartbeat_seen|store|restore_defaults)E",
    r"3mrr3can8LssSlave": r"^_ZN3mrr2fw6Module\d+store_node_idE",
    r"3mrr3can14ParameterStore": r"^_ZN3mrr2fw10FlashStore\d+(read|erase|write|flush)E",
    r"3mrr2fw10FlashStore": r"13EmulatedFlash\d+(bytes|page_bytes|state|erase|program)E",
    r"reset_handler": r"_GLOBAL__sub_I",
}
LIBRARY_BYTES = 64  # memcpy, memset, 64-bit division: leaves of newlib and libgcc, compiled without this information
EXCEPTION_BYTES = 112  # what a Cortex-M4F stacks on its own before a handler, floating point included, aligned


def main(limit, files):
    frames, calls = {}, {}
    for file in files:
        text = open(file, encoding="utf-8").read()
        for title, label in re.findall(r'node: \{ title: "([^"]+)" label: "([^"]*)"', text):
            size = re.search(r"(\d+) bytes \((\w+(?:,\w+)?)\)", label)
            if size:
                if size[2] not in ("static", "dynamic,bounded"):
                    sys.exit(f"{title}: a frame of unknown size ({size[2]})")
                frames[title] = int(size[1])
        for source, target in re.findall(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text):
            calls.setdefault(source, set()).add(target)

    def targets(function):
        for target in calls.get(function, ()):
            if target != "__indirect_call":
                yield target
                continue
            pattern = next((p for caller, p in INDIRECT.items() if caller in function), None)
            if pattern is None:
                sys.exit(f"{function}: calls what is not known")
            found = [f for f in frames if re.search(pattern, f)]
            if not found:
                sys.exit(f"{function}: nothing matches {pattern}")
            yield from found

    on_path = []

    @lru_cache(maxsize=None)
    def deepest(function):
        if function in on_path:
            sys.exit("a recursion: " + " -> ".join(on_path + [function]))
        if function not in frames:
            return LIBRARY_BYTES, (function,)
        on_path.append(function)
        below = max((deepest(t) for t in targets(function)), default=(0, ()))
        on_path.pop()
        return frames[function] + below[0], (function, *below[1])

    def show(root):
        bytes_, path = deepest(root)
        print(f"{root}: {bytes_} bytes")
        for function in path:
            print(f"  {frames.get(function, LIBRARY_BYTES):6}  {function}")
        return bytes_

    start = show("reset_handler")
    tick = show("SysTick_Handler")
    # The tick interrupts main(), which waits for it: start() and the constructors are over then.
    total = max(start, frames["reset_handler"] + frames["main"] + EXCEPTION_BYTES + tick)
    print(f"stack: {total} of {limit} bytes")
    return 0 if total <= limit else 1


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), sys.argv[2:]))
