from .calibration import write_calibration_page as write_calibration_page
from .calibration_figures import residuals_figure as residuals_figure
from .cell_drawing import cell_plan as cell_plan
from .certificate import (
    PRINTERS as PRINTERS,
    Choices as Choices,
    every_figure as every_figure,
    headline as headline,
    write_certificate as write_certificate,
)
from .certificate_text import about as about, title as title
from .comparison import distances_figure as distances_figure, reported as reported, write_comparison_page as write_comparison_page
from .correction import write_correction_page as write_correction_page
from .demonstration import Part as Part, write_demo_page as write_demo_page
from .fleet import FleetItem as FleetItem, write_fleet_page as write_fleet_page
from .html import BASE_STYLE as BASE_STYLE, blocks as blocks, kept as kept
from .inspection import write_inspection_page as write_inspection_page, zone_lines as zone_lines
from .interim import write_check_page as write_check_page
from .mechanism import workspace_words as workspace_words, write_mechanism_page as write_mechanism_page
from .plots import (
    Figure as Figure,
    errors_beside_figure as errors_beside_figure,
    fault_figure as fault_figure,
    figure_of as figure_of,
    playing_figure as playing_figure,
    scans_figure as scans_figure,
)
from .qualification import qualification_pdf as qualification_pdf
from .rig_drawing import write_rig_page as write_rig_page
from .robot import write_robot_page as write_robot_page
from .structure import write_list_page as write_list_page, write_structure_page as write_structure_page
from .summary import Glance as Glance, glance as glance
from .text import word as word
from .trajectory import (
    about_stretch as about_stretch,
    trajectory_summary as trajectory_summary,
    write_trajectory_page as write_trajectory_page,
)
from .zone_figures import u95_figure as u95_figure
from .zone_html import write_zone_page as write_zone_page, write_zone_report as write_zone_report
