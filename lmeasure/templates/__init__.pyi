from .files import (
    folder_files as folder_files,
)
from .files import (
    rig_text as rig_text,
)
from .shapes import (
    DRUM as DRUM,
)
from .shapes import (
    PULLEY_RADIUS_MM as PULLEY_RADIUS_MM,
)
from .shapes import (
    TEMPLATES as TEMPLATES,
)
from .shapes import (
    Answers as Answers,
)
from .shapes import (
    Template as Template,
)
from .shapes import (
    rig_of as rig_of,
)
