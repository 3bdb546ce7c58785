"""The package for colcon; the extra `[ros]` of anchorflow brings the same modules."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import setup

NAME = "anchorflow_ros"

setup(
    name=NAME,
    version=ElementTree.parse("package.xml").findtext("version"),
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *(
            (f"share/{NAME}/{folder}", [str(path) for path in sorted(Path(folder).iterdir())])
            for folder in ("config", "launch")
        ),
    ],
    zip_safe=True,
    maintainer="AnchorFlow contributors",
    description="Drives a robot by AnchorFlow's anchors.",
    license="MIT",
    entry_points={
        "console_scripts": [
            f"node = {NAME}.node:main",
            f"simulator = {NAME}.simulator:main",
        ]
    },
)
