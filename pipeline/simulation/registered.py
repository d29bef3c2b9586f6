"""Registers our environments as it is imported, which Gymnasium asks of the module before an id's colon:

    gymnasium.make("pipeline.simulation.registered:hardcase/PickPlace-v0")
"""

from pipeline.simulation.register import register

register()
