"""`ros2 launch rosld serve.launch.py [source:=...] [options:='--port 8081 ...']`"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackagePrefix


def generate_launch_description() -> LaunchDescription:
    serve = PathJoinSubstitution([FindPackagePrefix("rosld"), "lib", "rosld", "serve"])
    # A shell splits the options into words.
    words = ["exec", serve, LaunchConfiguration("source"), LaunchConfiguration("options")]
    return LaunchDescription(
        [
            DeclareLaunchArgument("source", default_value="ros2:", description="The robot"),
            DeclareLaunchArgument("options", default_value="", description="Options of rosld serve"),
            ExecuteProcess(cmd=words, shell=True, name="rosld", output="screen"),
        ]
    )
