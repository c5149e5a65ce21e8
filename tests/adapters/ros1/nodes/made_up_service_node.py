"""A service of a type without a package on this machine: made_up_service_node.py CLASSES_FOLDER DEFINITION."""

import subprocess
import sys
from pathlib import Path

import rospy

folder, definition = Path(sys.argv[1]), sys.argv[2]
services = folder / "made_up_msgs" / "srv"
services.mkdir(parents=True)
subprocess.run(
    ["/usr/bin/python3", "/usr/lib/genpy/gensrv_py.py", "-p", "made_up_msgs", "-o", str(services), definition],
    check=True,
    stdout=subprocess.DEVNULL,
)
(services / "__init__.py").write_text("from ._Fold import *\n")
(folder / "made_up_msgs" / "__init__.py").write_text("")
sys.path.insert(0, str(folder))

from made_up_msgs.srv import Fold, FoldResponse  # noqa: E402

rospy.init_node("made_up")
rospy.Service("/fold", Fold, lambda request: FoldResponse(request.angle == 0.5))
print("ready", flush=True)
rospy.spin()
