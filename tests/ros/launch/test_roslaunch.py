"""What a launch says of nodes that fail."""

from pathlib import Path
from unittest import mock

import pytest

from zswarm.errors import EvaluationError
from zswarm.ros.launch import roslaunch


def test_a_node_that_ends_before_roslaunch_looks_at_it_is_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Then roslaunch gives no pid; the text is what it wrote on a busy machine."""
    output = (
        "process[rosout-1]: started with pid [7]\nstarted core service [/rosout]\n"
        "cannot load the map\nfailed to start local process: /rough/node.sh fails\n"
        + "="
        * 80
        + "REQUIRED process [node-2] has died!\n"
        "process has died [pid None, exit code 7, cmd /rough/node.sh fails].\n"
        "Initiating shutdown!\n"
    )
    supervisor = mock.create_autospec(roslaunch.Supervisor)
    supervisor.run.return_value = roslaunch.LaunchEnded(0, output)
    monkeypatch.setattr(roslaunch.shutil, "which", lambda *_, **__: "roslaunch")
    environment = {"ROS_HOME": f"{tmp_path}/home", "ROS_LOG_DIR": f"{tmp_path}/log"}
    with pytest.raises(
        EvaluationError,
        match=r"^node node-2 ended with code 7; it wrote: .*cannot load the map$",
    ):
        roslaunch.launch(supervisor, tmp_path / "rough.launch", {}, environment)
