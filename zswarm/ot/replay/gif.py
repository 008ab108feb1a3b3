"""Draw a trial as an animated GIF, for slides and web pages, with Pillow of the extra ``plot``."""

import io
from functools import cache
from typing import Any

from zswarm.errors import ConfigError
from zswarm.ot.replay import svg as film
from zswarm.ot.replay.appearance import colours, corners, nose, scaled, sized
from zswarm.ot.replay.trace import Trace
from zswarm.sims.simulator import Body, Frame
from zswarm.system.extras import need
from zswarm.system.text import clean

SIDE = 480  # pixels of the longer side of the field
FINER = 2  # pictures are drawn larger by this factor, then reduced: smooth edges
LINE, LETTER = 22, 14  # pixels: of a line of text, of its letters
MOST_FRAMES = 150
WHITE, FIELD, EDGE, INK = "#ffffff", "#fafafa", "#bbbbbb", "#333333"
COLOURS = 128


def gif(trace: Trace, title: str) -> bytes:
    """Return the file; raise ConfigError if Pillow is missing, or the simulator draws nothing."""
    if not trace.frames:
        raise ConfigError(
            f"{clean(title)}: its simulator draws no picture; expected html or csv"
        )
    painter, count = _Painter(trace, clean(title)), len(trace.frames)
    pictures = [
        painter.picture(trace.frames[number], trace.at(number))
        for number in film.thinned(count, MOST_FRAMES)
    ]
    palette = pictures[len(pictures) // 2].quantize(COLOURS)
    undithered = painter.pillow.Dither.NONE
    pictures = [
        picture.quantize(palette=palette, dither=undithered) for picture in pictures
    ]
    each = max(20, round(1000 * film.play_s(count) / len(pictures)))
    durations = [each] * (len(pictures) - 1) + [round(1000 * film.HOLD_S)]
    file, (first, *more) = io.BytesIO(), pictures
    first.save(
        file,
        "GIF",
        save_all=True,
        append_images=more,
        duration=durations,
        loop=0,
        optimize=False,
    )
    return file.getvalue()


class _Painter:
    """Draws the frames of a trial."""

    def __init__(self, trace: Trace, title: str) -> None:
        self.pillow, self.drawing, fonts = (
            need(f"PIL.{name}", "plot", "replay --to gif")
            for name in ("Image", "ImageDraw", "ImageFont")
        )
        self.letters = cache(fonts.load_default)
        self.font = self.letters(FINER * LETTER)
        self.trace, self.title = trace, title
        first = trace.frames[0]
        self.scale = FINER * SIDE / max(first.width, first.height)
        self.places = sized(first.places, self.scale)
        self.colours = colours(trace.frames)
        self.width = max(round(first.width * self.scale), FINER * SIDE // 2)
        self.field_height = round(first.height * self.scale)
        self.top = FINER * LINE * 2
        self.legend = film.placed(
            self.colours,
            self.width,
            FINER * 2,
            lambda kind: FINER * 30 + round(self.font.getlength(clean(kind))),
        )
        rows = 1 + max((row for _, _, row in self.legend), default=0)
        self.height = (
            self.top + self.field_height + FINER * LINE * rows + FINER * LINE // 2
        )

    def picture(self, frame: Frame, at: int) -> Any:
        """Draw one frame."""
        image = self.pillow.new("RGB", (self.width, self.height), WHITE)
        draw = self.drawing.Draw(image)
        left, below = FINER * 2, self.top + self.field_height
        text = f"round {at} of {self.trace.rounds}"
        draw.text((left, FINER * 3), self._fitting(self.title), INK, self.font)
        draw.text((left, FINER * (LINE + 2)), text, INK, self.font)
        field = self.pillow.new("RGB", (self.width, self.field_height), FIELD)
        self._field(self.drawing.Draw(field), scaled(frame, self.scale))
        image.paste(field, (0, self.top))
        draw.rectangle((0, self.top, self.width - 1, below - 1), outline=EDGE)
        for kind, x, row in self.legend:
            y = below + FINER * (LINE * row + 6)
            box = (x, y, x + FINER * 11, y + FINER * 11)
            draw.rectangle(box, self.colours[kind], EDGE)
            draw.text((x + FINER * 16, y - FINER * 3), clean(kind), INK, self.font)
        size = (self.width // FINER, self.height // FINER)
        return image.resize(size, self.pillow.Resampling.LANCZOS)

    def _field(self, draw: Any, frame: Frame) -> None:
        for kind, x, y, width, height in self.places:
            draw.rectangle(
                (x, y, x + max(width, 0), y + max(height, 0)), self.colours[kind]
            )
        for line in frame.lines:
            draw.line(line[1:], self.colours[line.kind], FINER * 3)
        for body in reversed(frame.bodies):
            self._body(draw, body._replace(radius=max(body.radius, FINER * 1.5)))
        for label in frame.labels:
            font = self.letters(max(label.size, FINER * 9))
            draw.text((label.x, label.y), clean(label.text), INK, font, anchor="mm")

    def _body(self, draw: Any, body: Body) -> None:
        colour, x, y, radius = self.colours[body.kind], body.x, body.y, body.radius
        if body.shape != "disc":
            draw.polygon(corners(body), colour)
            return
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), colour)
        if body.heading is not None:
            draw.line([(x, y), nose(body)], WHITE, max(FINER, round(0.28 * radius)))

    def _fitting(self, text: str) -> str:
        while text and self.font.getlength(text) > self.width - FINER * 4:
            text = f"{text[:-2]}…"
        return text
