"""Everything of telefuse that touches the world: transports, storage, HTTP, webhooks, commands."""

import os

from service import compile_cache

compile_cache.choose()
# Matrices here are small: threads within one cost more than they save, up to tenfold where others want the cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
