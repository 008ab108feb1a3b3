"""Builds the package; its controller is compiled where there is a C compiler, else it is computed in Python."""

import os
import subprocess
import sys

from setuptools import setup
from setuptools.command.build_py import build_py

NAME = "@{name}"


class Compiled(build_py):
    """Adds librobot.so, of the C files in src."""

    def run(self):
        """Build, then compile."""
        super().run()
        library = os.path.join(self.build_lib, NAME, "librobot.so")
        command = [os.environ.get("CC", "cc"), "-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-o", library]
        try:
            subprocess.run([*command, "src/robot.c", "src/interface.c", f"src/{NAME}.c", "-lm"], check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            print(f"not compiled, the controller will be computed in Python: {error}", file=sys.stderr)


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
    maintainer="Whoever evolved it",
    maintainer_email="robots@example.com",
    description="A robot's controller, evolved with zswarm",
    license="Apache-2.0",
    entry_points={"console_scripts": [f"drive = {NAME}.node:main"]},
    cmdclass={"build_py": Compiled},
)
