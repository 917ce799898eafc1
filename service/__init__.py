"""Everything of telefuse that touches the world: transports, storage, HTTP, webhooks, commands."""

from service import compile_cache

compile_cache.choose()
