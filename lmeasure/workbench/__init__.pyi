from .processes import ONE as ONE, READY as READY
from .server import serve as serve
