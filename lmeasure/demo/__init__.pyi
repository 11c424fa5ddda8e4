from .cell_demo import Demo as Demo, demo as demo
from .interactive_cell import Built as Built, PlayedCell as PlayedCell
from .robot_in_cell import (
    OF_CELL as OF_CELL,
    OF_ROBOT as OF_ROBOT,
    RobotDemo as RobotDemo,
    existing as existing,
    fresh as fresh,
    robot_demo as robot_demo,
)
from .robot_loop import judge as judge, write_correction as write_correction, write_identification as write_identification
