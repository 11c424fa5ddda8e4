from .recording import open_viewer as open_viewer
from .scene import Series as Series, write_scene as write_scene
from .stages import (
    growing_counts as growing_counts,
    streamed_recording as streamed_recording,
    write_counts_recording as write_counts_recording,
    write_mechanism_recording as write_mechanism_recording,
    write_recording as write_recording,
    write_structure_recording as write_structure_recording,
)
from .web import policy as policy, serve as serve, viewer_file as viewer_file
