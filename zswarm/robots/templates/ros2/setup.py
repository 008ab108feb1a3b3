"""Builds the package; the controller is compiled if there is a C compiler, else runs in Python."""

import os
import subprocess
import sys

from setuptools import setup
from setuptools.command.build_py import build_py

NAME = "@{name}"
FLAGS = ["-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared"]
SOURCES = ["src/robot.c", "src/interface.c", f"src/{NAME}.c", "-lm"]


class Compiled(build_py):
    """Adds librobot.so, of the C files in src."""

    def run(self):
        """Build, then compile."""
        super().run()
        library = os.path.join(self.build_lib, NAME, "librobot.so")
        command = [os.environ.get("CC", "cc"), *FLAGS, "-o", library, *SOURCES]
        try:
            subprocess.run(command, check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            text = f"not compiled, the controller will be computed in Python: {error}"
            print(text, file=sys.stderr)


setup(
    name=NAME,
    version="1.0.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/drive.launch.py"]),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    maintainer="A user of zswarm",
    maintainer_email="robots@example.com",
    description="A robot's controller, evolved with zswarm",
    license="Apache-2.0",
    entry_points={"console_scripts": [f"drive = {NAME}.node:main"]},
    cmdclass={"build_py": Compiled},
)
