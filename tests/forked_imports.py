"""Imports of every server and query process, executed once for all forks."""

import gc

import rosld.adapters.aircraft
import rosld.adapters.recording
import rosld.adapters.ros1
import rosld.adapters.rover
import rosld.server.app
import rosld.server.cli.serve
import rosld.server.sparql.process.keeper  # noqa: F401

gc.collect()
gc.freeze()  # keeps garbage collections from writing to shared pages
