from .cell_demo import (
    Demo as Demo,
)
from .cell_demo import (
    demo as demo,
)
from .correction import (
    write_correction as write_correction,
)
from .folder import (
    OF_CELL as OF_CELL,
)
from .folder import (
    OF_ROBOT as OF_ROBOT,
)
from .folder import (
    existing as existing,
)
from .folder import (
    fresh as fresh,
)
from .identification import (
    judge as judge,
)
from .identification import (
    write_identification as write_identification,
)
from .interactive_cell import (
    Built as Built,
)
from .interactive_cell import (
    PlayedCell as PlayedCell,
)
from .robot_in_cell import (
    RobotDemo as RobotDemo,
)
from .robot_in_cell import (
    robot_demo as robot_demo,
)
