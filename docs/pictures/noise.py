"""Draw noise.png, the figure of docs/noise.md, from a real run: python docs/pictures/noise.py.

It is the example minisim, the best of whose fifth, tenth, ... generations play held-out seeds.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import zswarm
from zswarm.ot.analysis import curves, figures

PICTURE = Path(__file__).with_suffix(".png")


def main() -> None:
    """Run and draw."""
    with tempfile.TemporaryDirectory() as folder:
        run = [sys.executable, "-m", "zswarm.ot", "run", "minisim", "--servers", "local"]
        run += ["--set", "assessment.track=5", "--out", folder]
        subprocess.run(run, check=True)
        figures.plain_style()
        numbers = curves.series(zswarm.read(Path(folder) / "minisim"))
        figures.save(figures.of_series({"minisim": [numbers]}, size="screen"), PICTURE)


if __name__ == "__main__":
    main()
