"""The history of a run as a table, for pandas and polars."""

from typing import TYPE_CHECKING, Any

from zswarm.system.extras import need

if TYPE_CHECKING:
    import pandas
    import polars

Row = dict[str, Any]


def flat(history: list[Row]) -> list[Row]:
    """Return a history with a key for each of the optimizer's statistics."""
    statistics = [row.pop("statistics") for row in history]
    names = dict.fromkeys(name for values in statistics for name in values)
    return [
        row | {name: values.get(name) for name in names if name not in row}
        for row, values in zip(history, statistics, strict=True)
    ]


def to_pandas(rows: list[Row]) -> "pandas.DataFrame":
    """Return rows as a frame; raise ConfigError if pandas is missing."""
    frame: pandas.DataFrame = need("pandas", "data", "to_pandas").DataFrame(rows)
    return frame


def to_polars(rows: list[Row]) -> "polars.DataFrame":
    """Return rows as a frame; raise ConfigError if polars is missing."""
    library = need("polars", "data", "to_polars")
    frame: polars.DataFrame = library.DataFrame(rows, infer_schema_length=None)
    return frame
