from .processes import (
    ONE as ONE,
)
from .processes import (
    READY as READY,
)
from .server import (
    serve as serve,
)
