"""Thesaurus: the words that people use of robots, and the types, fields and names by which robots show the same."""

# ruff: noqa: E501

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from rosld.server.search.words import stem, words_of


class Concept(NamedTuple):
    """What people mean by some words, and how it is recognized on a robot.

    `words` are those of people, with `_` for a space. `marks` are those of robots: words in names of resources, types
    and fields; people use them, too. `types` carry the concept whatever they are called. `commands` is whether these
    command the robot, or report on it.
    """

    name: str
    commands: bool
    words: str
    marks: str
    types: str = ""


_DO, _ASK = True, False
CONCEPTS = (
    Concept("drive", _DO, "go forward forwards backward backwards reverse left right ride travel run fast faster slow slower walk fly spin around way", "drive move turn steer rotate speed velocity vel twist motor throttle teleop", "geometry_msgs/Twist geometry_msgs/TwistStamped ackermann_msgs/AckermannDrive ackermann_msgs/AckermannDriveStamped ros2_control_msgs/Twist nav2_msgs/DriveOnHeading nav2_msgs/Spin nav2_msgs/BackUp irobot_create_msgs/DriveDistance irobot_create_msgs/DriveArc irobot_create_msgs/RotateAngle turtlesim/Velocity turtle_actionlib/Shape mavros_msgs/PositionTarget mavros_msgs/ManualControl"),
    Concept("speed", _ASK, "fast slow quick going go move drive turn motion", "speed velocity twist", "nav_msgs/Odometry geometry_msgs/TwistWithCovariance geometry_msgs/TwistWithCovarianceStamped"),
    Concept("place", _ASK, "where located facing heading coordinates whereabouts direction place standing stand turned travelled driven", "pose position location localization odometry theta heading yaw", "nav_msgs/Odometry geometry_msgs/Pose geometry_msgs/Pose2D geometry_msgs/PoseStamped geometry_msgs/PoseWithCovariance geometry_msgs/PoseWithCovarianceStamped turtlesim/Pose"),
    Concept("journey", _DO, "go_to drive_to move_to come_to head_to walk_to fly_to bring send destination target point aim kitchen room there travel", "navigate navigation goal waypoint goto", "nav2_msgs/NavigateToPose nav2_msgs/NavigateThroughPoses nav2_msgs/FollowWaypoints move_base_msgs/MoveBase move_base_msgs/MoveBaseAction move_base_msgs/MoveBaseActionGoal irobot_create_msgs/NavigateToPosition"),
    Concept("dock", _DO, "charger charging_station home back return station garage park recharge", "dock undock homing", "nav2_msgs/DockRobot opennav_docking_msgs/DockRobot irobot_create_msgs/Dock irobot_create_msgs/Undock kobuki_msgs/AutoDocking"),
    Concept("camera", _ASK, "picture photo photograph see look watch view video eye stream film snapshot show_me", "camera image rgb webcam usb_cam", "sensor_msgs/Image sensor_msgs/CompressedImage theora_image_transport/Packet stereo_msgs/DisparityImage"),
    Concept("distance", _ASK, "far near nearest nearby close closest obstacle front wall away ahead blocked path_clear", "lidar laser scan range distance sonar ultrasonic proximity ranges radar tof", "sensor_msgs/LaserScan sensor_msgs/MultiEchoLaserScan sensor_msgs/Range irobot_create_msgs/IrIntensityVector"),
    Concept("point cloud", _ASK, "3d three-dimensional point_cloud scene", "depth cloud pointcloud points velodyne", "sensor_msgs/PointCloud2 sensor_msgs/PointCloud velodyne_msgs/VelodyneScan livox_ros_driver2/CustomMsg"),
    Concept("map", _ASK, "floor floor_plan room house layout building walls surroundings environment", "map costmap occupancy grid octomap slam", "nav_msgs/OccupancyGrid map_msgs/OccupancyGridUpdate nav_msgs/MapMetaData nav_msgs/GetMap octomap_msgs/Octomap grid_map_msgs/GridMap nav2_msgs/Costmap"),
    Concept("route", _ASK, "way planned planning going_to course", "path plan route trajectory planner", "nav_msgs/Path nav2_msgs/ComputePathToPose nav_msgs/GetPlan"),
    Concept("arm", _DO, "hand finger elbow shoulder wrist grab hold pick release put reach", "arm joint gripper grasp manipulator trajectory servo actuator", "trajectory_msgs/JointTrajectory control_msgs/FollowJointTrajectory control_msgs/FollowJointTrajectoryAction control_msgs/GripperCommand control_msgs/GripperCommandAction control_msgs/ParallelGripperCommand control_msgs/JointJog moveit_msgs/MoveGroup moveit_msgs/MoveGroupAction"),
    Concept("joints", _ASK, "arm hand gripper finger manipulator angle elbow shoulder wrist pose position", "joint", "sensor_msgs/JointState control_msgs/JointTrajectoryControllerState control_msgs/DynamicJointState dynamixel_sdk_custom_interfaces/GetPosition"),
    Concept("battery", _ASK, "charged charging energy juice full empty left remaining long current electricity plugged", "battery power voltage charge volt percentage accumulator soc", "sensor_msgs/BatteryState kobuki_msgs/SensorState smart_battery_msgs/SmartBatteryStatus irobot_create_msgs/DockStatus"),
    Concept("temperature", _ASK, "hot heat warm cold cool degree overheating thermometer", "temperature thermal temp celsius fan", "sensor_msgs/Temperature"),
    Concept("weather", _ASK, "air altitude barometer humid moisture dry wet", "humidity pressure fluid", "sensor_msgs/RelativeHumidity sensor_msgs/FluidPressure"),
    Concept("tilt", _ASK, "tilted tip upright level fall fallen lean shake shaking roll pitch accelerating vibration compass north", "imu acceleration gyro gyroscope accelerometer inclination orientation magnetometer attitude mag", "sensor_msgs/Imu sensor_msgs/MagneticField geometry_msgs/QuaternionStamped geometry_msgs/AccelStamped"),
    Concept("gps", _ASK, "satellite earth global outdoors street geographic where", "gps gnss latitude longitude navsat fix altitude", "sensor_msgs/NavSatFix sensor_msgs/NavSatStatus gps_msgs/GPSFix gps_common/GPSFix geographic_msgs/GeoPoseStamped geographic_msgs/GeoPointStamped"),
    Concept("health", _ASK, "wrong problem broken ok okay working well alive trouble healthy sick bad happening state condition", "diagnostic health error fault warning alarm failure status", "diagnostic_msgs/DiagnosticArray diagnostic_msgs/DiagnosticStatus"),
    Concept("log", _ASK, "message printed print output console said happened text", "rosout log logger", "rosgraph_msgs/Log rcl_interfaces/Log"),
    Concept("sound", _DO, "say speak talk tell voice music noise beep horn loud hear microphone announce honk volume listen", "sound audio speech speaker tts buzzer", "audio_common_msgs/AudioData audio_msgs/Audio sound_play/SoundRequest kobuki_msgs/Sound irobot_create_msgs/AudioNote irobot_create_msgs/AudioNoteVector irobot_create_msgs/AudioNoteSequence turtlebot3_msgs/Sound"),
    Concept("light", _DO, "headlight lit bright brightness dark shine flash colour color glow bulb", "light lamp led lights illumination beacon", "kobuki_msgs/Led irobot_create_msgs/LedColor irobot_create_msgs/LightringLeds sensor_msgs/Illuminance"),
    Concept("switch", _DO, "turn_on turn_off switch_on switch_off on off activate deactivate start", "enable disable switch power toggle", "std_srvs/SetBool kobuki_msgs/MotorPower"),
    Concept("door", _DO, "open close shut floor storey", "door lift elevator gate", "rmf_door_msgs/DoorRequest rmf_lift_msgs/LiftRequest rmf_door_msgs/DoorState rmf_lift_msgs/LiftState"),
    Concept("stop", _DO, "freeze immediately panic abort danger standstill kill", "stop halt emergency estop brake", "std_srvs/Empty irobot_create_msgs/StopStatus"),
    Concept("collision", _ASK, "touch bump hit crash contact push collide cliff edge bumped collided stuck", "bumper bump collision contact cliff hazard", "kobuki_msgs/BumperEvent kobuki_msgs/CliffEvent irobot_create_msgs/HazardDetectionVector gazebo_msgs/ContactsState"),
    Concept("button", _ASK, "press pressed gamepad controller stick remote", "button joystick joy", "sensor_msgs/Joy kobuki_msgs/ButtonEvent irobot_create_msgs/InterfaceButtons"),
    Concept("force", _ASK, "hard strong strength weight heavy push pull load feel", "force torque wrench effort", "geometry_msgs/Wrench geometry_msgs/WrenchStamped"),
    Concept("wheels", _ASK, "turn rolled slip odometer wheelbase", "wheel encoder tick", "irobot_create_msgs/WheelTicks irobot_create_msgs/WheelVels irobot_create_msgs/SlipStatus create_msgs/WheelTicks"),
    Concept("clock", _ASK, "time hour date what_time simulated", "clock", "rosgraph_msgs/Clock sensor_msgs/TimeReference"),
    Concept("frames", _ASK, "coordinate coordinates frame mounted reference relative", "tf transform tf_static", "tf2_msgs/TFMessage tf/tfMessage geometry_msgs/TransformStamped"),
    Concept("recordings", _DO, "recorded past history before earlier yesterday replay black_box", "recording record bag rosbag", "rosbag2_interfaces/Snapshot rosbag2_interfaces/Record"),
    Concept("setting", _DO, "limit maximum minimum most least highest fastest allowed configure configuration adjust option preference", "parameter setting max min limit config mode threshold"),
    Concept("name", _ASK, "called identity who whose", "name serial hostname"),
    Concept("people", _ASK, "person human somebody face anyone object recognized", "people person detection detections face object tracked", "vision_msgs/Detection2DArray vision_msgs/Detection3DArray people_msgs/People people_msgs/PositionMeasurementArray apriltag_msgs/AprilTagDetectionArray"),
)  # fmt: skip


def _index(pairs: Iterable[tuple[str, Concept]]) -> Mapping[str, Sequence[Concept]]:
    found: dict[str, list[Concept]] = {}
    for key, concept in pairs:
        found.setdefault(key, []).append(concept)
    return found


PHRASES = frozenset(word.replace("_", " ") for each in CONCEPTS for word in each.words.split() if "_" in word)
"""Words that mean something else together, such as `go to`."""
KNOWN = frozenset(word for each in CONCEPTS for word in f"{each.words} {each.marks}".split())
MARKS = _index((mark, each) for each in CONCEPTS for mark in {stem(word) for word in each.marks.split()})
"""Concepts by the stems of their marks."""
WORDS = _index(
    (word, each)
    for each in CONCEPTS
    for word in {stem(word.replace("_", " ")) for word in f"{each.words} {each.marks}".split()}
)
"""Concepts by the stems of the words of people, and by phrases."""
_TYPES = _index((name, each) for each in CONCEPTS for name in each.types.split())


def concepts_of_type(name: str) -> Sequence[Concept]:
    """Return the concepts that a type carries by its name (`geometry_msgs/msg/Twist`) in ROS."""
    return _TYPES.get(f"{name.partition('/')[0]}/{name.rpartition('/')[2]}", ())


def marked_concepts(names: Iterable[str]) -> set[Concept]:
    """Return the concepts that are marked by the words of these names."""
    return {concept for name in names for word in words_of(name) for concept in MARKS.get(stem(word), ())}
