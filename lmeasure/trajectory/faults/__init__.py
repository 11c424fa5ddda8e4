"""Faults of channels in a run: steps, slips, stuck counters, contradictions, and how reliable their detection is."""
