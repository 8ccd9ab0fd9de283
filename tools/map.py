#!/usr/bin/python3
"""Draws an impact measure over the workspace.

    tools/map.py MAP.json PICTURE       PICTURE ends in .png or .svg

MAP.json is what `mrr map --json` prints. Needs Debian's python3-numpy and python3-matplotlib.
"""

import argparse
import json
import pathlib
import sys

sys.dont_write_bytecode = True  # an installation may be shared


def draw(data, picture):
    import matplotlib.pyplot as plt
    import numpy as np
    from mrr_report import style

    values = np.array([[np.nan if v is None else v for v in row] for row in data["values"]], dtype=float)
    along, up = np.array(data["along_m"]), np.array(data["up_m"])
    low, high = data["scale"]
    figure, axes = plt.subplots(figsize=(7.2, 5.6))
    axes.grid(False)
    image = axes.pcolormesh(along, up, np.ma.masked_invalid(values), cmap="viridis", vmin=low, vmax=high,
                            shading="nearest", rasterized=True)
    axes.plot(*data["nail_m"], marker="v", markersize=8, color=style.ORANGE, markeredgecolor=style.PAPER, linestyle="none",
              label="head of the task's nail")
    axes.plot(0.0, 0.0, marker="s", markersize=6, color=style.INK, linestyle="none", label="base")
    reached = np.isfinite(values)
    if reached.any():  # no blank margins, but base and nail stay in sight
        step_x, step_y = along[1] - along[0], up[1] - up[0]
        x = np.append(along[reached.any(axis=0)], [0.0, data["nail_m"][0]])
        y = np.append(up[reached.any(axis=1)], [0.0, data["nail_m"][1]])
        axes.set_xlim(x.min() - 2 * step_x, x.max() + 2 * step_x)
        axes.set_ylim(y.min() - 2 * step_y, y.max() + 2 * step_y)
    axes.set_aspect("equal")
    axes.set_xlabel("along the plane of base and nail, m")
    axes.set_ylabel("up, m")
    axes.set_title(f"{data['robot']}: {data['measure']} ({'most' if data['most_is_best'] else 'least'} is best)")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, -0.24), ncols=2, borderaxespad=0.0)
    bar = figure.colorbar(image, ax=axes, extend="both", shrink=0.85)
    bar.set_label(f"{data['measure']}, {data['unit']}" if data["unit"] != "1" else data["measure"])
    bar.outline.set_visible(False)
    figure.savefig(picture, dpi=160, facecolor=style.PAPER, metadata={"Date": None} if picture.suffix == ".svg" else None)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("map", type=pathlib.Path)
    parser.add_argument("picture", type=pathlib.Path)
    arguments = parser.parse_args()
    if arguments.picture.suffix not in (".png", ".svg"):
        print(f"map.py: {arguments.picture}: a picture's name ends in .png or .svg", file=sys.stderr)
        return 2
    try:
        draw(json.loads(arguments.map.read_text()), arguments.picture)
    except ImportError as error:
        print(f"map.py: {error}; install Debian's python3-numpy and python3-matplotlib", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"map.py: {error.filename}: {error.strerror}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
