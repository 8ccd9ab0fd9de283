"""Colours and type of all figures. A figure is drawn in the light theme's colours; in the page each of them becomes a
CSS variable, so that figures follow the reader's light or dark theme."""

import io
import re

import matplotlib

matplotlib.use("Agg")
import matplotlib.colors  # noqa: E402
import matplotlib.pyplot as plt  # noqa: E402

INK, MUTED, GRID, PAPER = "#1c2127", "#5b6571", "#dde1e6", "#fefefe"
WOOD, STEEL, SHADE = "#e7d8bd", "#8a939c", "#eceff3"
BLUE, ORANGE, GREEN, PURPLE, SKY, AMBER, GREY = (
    "#0b6db0", "#d4580a", "#0a8f6a", "#b0619a", "#3d9fd6", "#c98a00", "#767d85")  # after Okabe and Ito
JOINT_COLOURS = (GREY, GREEN, PURPLE, AMBER, SKY, BLUE, ORANGE)  # those of the modes last

DARK = {INK: "#e8ebee", MUTED: "#a3adb8", GRID: "#363d45", PAPER: "#15191d", WOOD: "#5a4a30", STEEL: "#a9b2bb",
        SHADE: "#262c33", BLUE: "#56b0f0", ORANGE: "#ff9250", GREEN: "#35c79c", PURPLE: "#e0a0cf", SKY: "#8fd0f7",
        AMBER: "#f0c04a", GREY: "#a0a8b0"}

LARGEST_SERIES = 12
_viridis = matplotlib.colormaps["viridis"]


def swing_colour(index, count):
    """Dark to light with the number of the swing; distinct in print and to the colour-blind."""
    step = round(index / max(count - 1, 1) * (LARGEST_SERIES - 1))
    return SWING_COLOURS[step]


SWING_COLOURS = [matplotlib.colors.to_hex(_viridis(0.05 + 0.75 * k / (LARGEST_SERIES - 1)))
                 for k in range(LARGEST_SERIES)]
DARK.update({light: matplotlib.colors.to_hex(_viridis(0.42 + 0.58 * k / (LARGEST_SERIES - 1)))
             for k, light in enumerate(SWING_COLOURS)})

_names = {light: f"--c{k}" for k, light in enumerate(DARK)}

plt.rcParams.update({
    "font.family": "sans-serif", "font.size": 9, "axes.titlesize": 9.5, "axes.titleweight": "bold",
    "axes.titlelocation": "left", "axes.labelsize": 9, "legend.fontsize": 8, "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5, "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": MUTED,
    "axes.titlecolor": INK, "xtick.color": MUTED, "ytick.color": MUTED, "xtick.labelcolor": INK,
    "ytick.labelcolor": INK, "axes.facecolor": "none", "figure.facecolor": "none", "axes.spines.top": False,
    "axes.spines.right": False, "axes.linewidth": 0.8, "axes.grid": True, "grid.color": GRID, "grid.linewidth": 0.7,
    "axes.axisbelow": True, "lines.linewidth": 1.4, "lines.solid_capstyle": "round", "legend.frameon": False,
    "legend.handlelength": 1.6, "legend.labelspacing": 0.3, "hatch.linewidth": 0.6, "savefig.facecolor": "none",
    "svg.fonttype": "none", "figure.constrained_layout.use": True,
})


def css():
    """The variables of both themes. Print takes the light one."""
    light = "".join(f"{name}:{colour};" for colour, name in _names.items())
    dark = "".join(f"{_names[colour]}:{value};" for colour, value in DARK.items())
    return f":root{{color-scheme:light dark;{light}}}@media screen and (prefers-color-scheme:dark){{:root{{{dark}}}}}"


def variable(colour):
    return f"var({_names[colour]})"


def inline_svg(figure, name, description):
    """The figure as an <svg> element for the page; ids are made unique by `name`."""
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    plt.close(figure)
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg"):]
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.S)
    svg = re.sub(r'<g id="[^"]*">', "<g>", svg)
    svg = re.sub(r'(<svg )([^>]*?)width="[^"]*"([^>]*?)height="[^"]*"', r"\1\2\3", svg, count=1)
    svg = re.sub(r'(<svg [^>]*?) height="[^"]*"', r"\1", svg, count=1)
    for own in set(re.findall(r'id="([^"]+)"', svg)):
        svg = svg.replace(f'id="{own}"', f'id="{name}-{own}"').replace(f"#{own}\"", f"#{name}-{own}\"")
        svg = svg.replace(f"url(#{own})", f"url(#{name}-{own})")
    for colour, variable_name in _names.items():
        svg = svg.replace(colour, f"var({variable_name})")
    return svg.replace("<svg ", f'<svg role="img" aria-label="{description}" ', 1)
