"""Theory of l-coordinate mechanisms: structures, forward problem, singularities, workspaces, synthesis. (Its own part of the plan.)"""
