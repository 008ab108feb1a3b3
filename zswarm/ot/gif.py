"""A trial as an animated GIF, for slides and web pages; drawn by Pillow, which the extra ``plot`` brings."""

import io
import math
from collections.abc import Sequence
from functools import cache
from typing import Any

from zswarm.errors import ConfigError
from zswarm.extras import need
from zswarm.ot import film
from zswarm.ot.trace import Trace
from zswarm.protocol.codec import clean
from zswarm.sims.simulator import Body, Frame

SIDE = 480  # pixels of the longer side of the field
FINER = 2  # as large it is drawn, and then made smaller: smooth edges
LINE, LETTER = 22, 14  # pixels of a line of text, and of its letters
MOST_FRAMES = 150
FRAME_S, SHORTEST_S, LONGEST_S, HOLD_S = 0.12, 3.0, 12.0, 1.5  # as in ``film``
WHITE, FIELD, EDGE, INK = "#ffffff", "#fafafa", "#bbbbbb", "#333333"
COLOURS = 128


def gif(trace: Trace, title: str) -> bytes:
    """The file.

    Raises:
        ConfigError: Pillow is missing, or the simulator draws nothing.
    """
    if not trace.frames:
        raise ConfigError(f"{clean(title)}: its simulator draws no picture; expected html or csv")
    pillow = need("PIL.Image", "plot", "replay --to gif")
    drawing = need("PIL.ImageDraw", "plot", "replay --to gif")
    fonts = need("PIL.ImageFont", "plot", "replay --to gif")
    every = -(-len(trace.frames) // MOST_FRAMES)
    chosen = [*range(0, len(trace.frames) - 1, every), len(trace.frames) - 1]
    painter = _Painter(trace, title, pillow, drawing, fonts)
    pictures = [painter.picture(trace.frames[number], trace.at(number)) for number in chosen]
    palette = pictures[len(pictures) // 2].quantize(COLOURS)
    pictures = [picture.quantize(palette=palette, dither=pillow.Dither.NONE) for picture in pictures]
    play_s = min(max(len(trace.frames) * FRAME_S, SHORTEST_S), LONGEST_S)
    durations = [max(20, round(1000 * play_s / len(pictures)))] * (len(pictures) - 1) + [round(1000 * HOLD_S)]
    file = io.BytesIO()
    pictures[0].save(file, "GIF", save_all=True, append_images=pictures[1:], duration=durations, loop=0, optimize=False)
    return file.getvalue()


class _Painter:
    """Draws the frames of a trial, one like the other."""

    def __init__(self, trace: Trace, title: str, pillow: Any, drawing: Any, fonts: Any) -> None:
        self.trace, self.title, self.pillow, self.drawing = trace, clean(title), pillow, drawing
        first = trace.frames[0]
        self.scale = FINER * SIDE / max(first.width, first.height)
        self.colours = film.colours(trace.frames)
        self.letters = cache(fonts.load_default)
        self.font = self.letters(FINER * LETTER)
        self.width = max(round(first.width * self.scale), FINER * SIDE // 2)
        self.field_height = round(first.height * self.scale)
        self.top = FINER * LINE * 2
        self.legend = self._legend(list(self.colours))
        rows = 1 + max((row for _, _, row in self.legend), default=0)
        self.height = self.top + self.field_height + FINER * LINE * rows + FINER * LINE // 2

    def picture(self, frame: Frame, at: int) -> Any:
        """One frame."""
        image = self.pillow.new("RGB", (self.width, self.height), WHITE)
        draw = self.drawing.Draw(image)
        draw.text((FINER * 2, FINER * 3), self._fitting(self.title), INK, self.font)
        draw.text((FINER * 2, FINER * (LINE + 2)), f"round {at} of {self.trace.rounds}", INK, self.font)
        field = self.pillow.new("RGB", (self.width, self.field_height), FIELD)
        self._field(self.drawing.Draw(field), frame)
        image.paste(field, (0, self.top))
        draw.rectangle((0, self.top, self.width - 1, self.top + self.field_height - 1), outline=EDGE)
        for kind, x, row in self.legend:
            y = self.top + self.field_height + FINER * (LINE * row + 6)
            draw.rectangle((x, y, x + FINER * 11, y + FINER * 11), self.colours[kind])
            draw.text((x + FINER * 16, y - FINER * 3), clean(kind), INK, self.font)
        return image.resize((self.width // FINER, self.height // FINER), self.pillow.Resampling.LANCZOS)

    def _field(self, draw: Any, frame: Frame) -> None:
        scale = self.scale
        for place in self.trace.frames[0].places:
            right, low = (place.x + place.width) * scale, (place.y + place.height) * scale
            draw.rectangle((place.x * scale, place.y * scale, max(right, place.x * scale), max(low, place.y * scale)),
                           self.colours[place.kind])  # fmt: skip
        for line in frame.lines:
            draw.line([line.x * scale, line.y * scale, line.to_x * scale, line.to_y * scale], self.colours[line.kind], FINER * 3)
        for body in reversed(frame.bodies):
            self._body(draw, body)
        for label in frame.labels:
            font = self.letters(max(label.size * scale, FINER * 9))
            draw.text((label.x * scale, label.y * scale), clean(label.text), INK, font, anchor="mm")

    def _body(self, draw: Any, body: Body) -> None:
        x, y, radius = body.x * self.scale, body.y * self.scale, max(body.radius * self.scale, FINER * 1.5)
        if body.shape == "disc":
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), self.colours[body.kind])
            if body.heading is not None:
                to_x, to_y = x + 0.9 * radius * math.cos(body.heading), y + 0.9 * radius * math.sin(body.heading)
                draw.line([x, y, to_x, to_y], WHITE, max(FINER, round(0.28 * radius)))
        else:
            draw.polygon([(x + radius * dx, y + radius * dy) for dx, dy in film.corners(body)], self.colours[body.kind])

    def _fitting(self, text: str) -> str:
        while text and self.font.getlength(text) > self.width - FINER * 4:
            text = f"{text[:-2]}…"
        return text

    def _legend(self, kinds: Sequence[str]) -> list[tuple[str, int, int]]:
        """Kinds with the column and row at which they are named."""
        placed, x, row = [], FINER * 2, 0
        for kind in kinds:
            wide = FINER * 30 + round(self.font.getlength(clean(kind)))
            if x > FINER * 2 and x + wide > self.width:
                x, row = FINER * 2, row + 1
            placed.append((kind, x, row))
            x += wide
        return placed
