"""Fail when a test was skipped whose module is not in .ci/allowed-skips.txt."""

import sys
import xml.etree.ElementTree as ET
from pathlib import Path

allowed = {
    line.split()[0]
    for line in (Path(__file__).parent / "allowed-skips.txt").read_text().splitlines()
    if line.strip() and not line.startswith("#")
}
cases = [case for report in sys.argv[1:] for case in ET.parse(report).iter("testcase")]  # noqa: S314  the files are our own
skips = [(case, case.find("skipped")) for case in cases]
late = [
    case
    for case, skip in skips
    if skip is not None and skip.get("message") == "out of time"
]
skipped = [case for case, skip in skips if skip is not None and case not in late]
if surprising := sorted(
    f"{case.get('classname')}.{case.get('name')}"
    for case in skipped
    if case.get("classname") not in allowed
):
    sys.exit("skipped, and not allowed to be: " + ", ".join(surprising))
sys.stdout.write(f"{len(cases)} tests, {len(skipped)} skipped as allowed\n")
if late:
    sys.stdout.write(
        f"OUT OF TIME: {len(late)} tests were not run on this slow machine\n"
    )
