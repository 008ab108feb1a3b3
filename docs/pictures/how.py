"""Draw docs/pictures/how.svg: the message flow. Run ``python docs/pictures/how.py``."""

from pathlib import Path

WIDTH, HEIGHT = 720, 262
TEXT, LINE, QUIET = "#1f2937", "#3366aa", "#6b7280"
PARTS: list[str] = []


def text(
    x: float,
    y: float,
    said: str,
    *,
    size: int = 13,
    fill: str = TEXT,
    weight: int = 400,
    anchor: str = "middle",
) -> None:
    """A line of text."""
    PARTS.append(
        f'<text x="{x:g}" y="{y:g}" font-family="sans-serif" font-size="{size}" '
        f'font-weight="{weight}" fill="{fill}" '
        f'text-anchor="{anchor}">{said}</text>'
    )


def box(
    x: float,
    y: float,
    width: float,
    height: float,
    *,
    fill: str = "#fff",
    stroke: str = "#9ca3af",
) -> None:
    """A rectangle with round corners."""
    PARTS.append(
        f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="6" fill="{fill}" '
        f'stroke="{stroke}"/>'
    )


def machine(y: float, name: str, slots: int) -> None:
    """A machine that computes, with its slots."""
    box(460, y, 250, 70, fill="#f3f7fc")
    text(474, y + 20, name, weight=600, anchor="start")
    text(474, y + 37, "zswarm-ss", size=12, fill=QUIET, anchor="start")
    for slot in range(slots):
        box(570 + 34 * slot, y + 14, 26, 26, stroke=LINE)
        text(583 + 34 * slot, y + 32, "▶", size=11, fill=LINE)
    text(698, y + 58, "a slot plays whole trials", size=11, fill=QUIET, anchor="end")
    PARTS.append(
        f'<path d="M 270 130 C 360 130 370 {y + 35:g} 452 {y + 35:g}" fill="none" stroke="{LINE}" '
        'stroke-width="2" '
        'marker-end="url(#to)" marker-start="url(#from)"/>'
    )


def main() -> None:
    """Write the picture."""
    box(10, 46, 258, 168, fill="#fdf8ee")
    text(24, 68, "your workstation", weight=600, anchor="start")
    text(24, 86, "zswarm-ot run my.toml", size=12, fill=QUIET, anchor="start")
    for row, said in enumerate(
        (
            "optimizer: asks, is told",
            "dispatch: who has what",
            "record: every candidate, every trial",
        )
    ):
        box(24, 98 + 36 * row, 230, 28)
        text(139, 117 + 36 * row, said, size=12)
    for number, (name, slots) in enumerate((("lab-01", 4), ("lab-02", 2), ("lab-03", 4))):
        machine(8 + 86 * number, name, slots)
    text(352, 26, "seeds and parameters", size=12, fill=LINE)
    text(352, 42, "of candidates: bytes", size=12, fill=LINE)
    text(352, 236, "fitness, metrics", size=12, fill=LINE)
    body = "\n".join(PARTS)
    heads = (("to", 6, "M0,0 L6,3 L0,6 z"), ("from", 0, "M6,0 L0,3 L6,6 z"))
    markers = "".join(
        f'<marker id="{name}" markerWidth="8" markerHeight="8" refX="{at}" refY="3" orient="auto">'
        f'<path d="{path}" fill="{LINE}"/></marker>'
        for name, at, path in heads
    )
    Path(__file__).with_name("how.svg").write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" viewBox="0 0 '
        f'{WIDTH} {HEIGHT}">\n'
        f'<rect width="{WIDTH}" height="{HEIGHT}" '
        f'fill="#fff"/>\n<defs>{markers}</defs>\n{body}\n</svg>\n'
    )


if __name__ == "__main__":
    main()
