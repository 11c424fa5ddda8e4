"""Robots under test and their identification. (Its own part of the plan.)"""
