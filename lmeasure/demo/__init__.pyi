from .cell_demo import Demo as Demo, demo as demo
from .correction import write_correction as write_correction
from .folder import OF_CELL as OF_CELL, OF_ROBOT as OF_ROBOT, existing as existing, fresh as fresh
from .identification import judge as judge, write_identification as write_identification
from .interactive_cell import Built as Built, PlayedCell as PlayedCell
from .robot_in_cell import RobotDemo as RobotDemo, robot_demo as robot_demo
