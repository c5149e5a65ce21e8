"""What every server and query process imports, imported once for all that are forked."""

import gc

import rosld.adapters.aircraft
import rosld.adapters.recording
import rosld.adapters.ros1
import rosld.adapters.rover
import rosld.server.app
import rosld.server.cli.serve
import rosld.server.sparql.process.keeper  # noqa: F401

gc.collect()
gc.freeze()  # what is shared is not written to by each collection
