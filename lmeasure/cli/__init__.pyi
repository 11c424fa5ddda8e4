from .app import program as program
