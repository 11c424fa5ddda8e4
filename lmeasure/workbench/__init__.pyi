from .guard import ON_LOOPBACK as ON_LOOPBACK, Site as Site
from .processes import ONE as ONE, READY as READY
from .server import serve as serve
