from .files import folder_files as folder_files, rig_text as rig_text
from .shapes import (
    DRUM as DRUM,
    PULLEY_RADIUS_MM as PULLEY_RADIUS_MM,
    TEMPLATES as TEMPLATES,
    Answers as Answers,
    Template as Template,
    rig_of as rig_of,
)
