"""Package of a ROS 2 workspace that starts rosld: it has no modules, so that those of pip's rosld are found."""

from setuptools import setup

setup(
    name="rosld-ros2",  # rosld is the distribution that pip installs
    version="0.2.0",
    packages=[],
    scripts=["serve"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["rosld"]),
        ("share/rosld", ["package.xml"]),
        ("share/rosld/launch", ["launch/serve.launch.py"]),
    ],
)
