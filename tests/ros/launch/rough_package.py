"""Write a package whose one node does what it is told, and its manifest, into a folder."""

import shutil
from pathlib import Path

NODE = Path(__file__).with_name("rough_node.sh")
PACKAGE = """<package format="2">
  <name>rough</name><version>0.1.0</version><description>goes wrong</description>
  <maintainer email="nobody@example.org">nobody</maintainer><license>Apache-2.0</license>
</package>
"""
LAUNCH = """<launch>
  <arg name="how"/> <arg name="robots"/> <arg name="seed"/>
  <node pkg="rough" type="node.sh" name="node" required="true" output="screen"
        args="$(arg how) $(find rough)/log $(arg robots) $(arg seed)"/>
</launch>
"""
MANIFEST = """
package = "rough"
launch = "rough.launch"
files = ["rough/rough.launch", "rough/node.sh"]
inputs = 1
outputs = 1
robots = "robots"
{more}
[controller]
form = "yaml"
file = "config/candidate.yaml"
{controller}
[seed]
argument = "seed"
[settings.how]
default = "fine"
argument = "how"
[settings.robots]
default = 2
argument = "robots"
[settings.epsilon]
default = 0.5
file = "config/frevo.yaml"
key = "epsilon"
[settings.count]
default = 1
file = "config/frevo.yaml"
key = "count"
[parameters."config/frevo.yaml"]
log_path = "{{package}}/log"
"""


def write(folder: Path, *, more: str = "", controller: str = "") -> Path:
    """Write the manifest ``rough.toml`` of the simulator ``rough``, and its package."""
    package = folder / "rough"
    package.mkdir()
    (package / "package.xml").write_text(PACKAGE)
    (package / "rough.launch").write_text(LAUNCH)
    shutil.copy(NODE, package / "node.sh")
    manifest = folder / "rough.toml"
    manifest.write_text(MANIFEST.format(more=more, controller=controller))
    return manifest
