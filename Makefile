# Everything runs in .venv, made from hashed locks; a machine needs Python >= 3.11 and make, nothing else.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
WORKERS ?= 2

.PHONY: setup browser demo test check bench format lock proto docs clean

setup: $(READY)

$(READY): requirements/lock.txt requirements/roads.txt requirements/bootstrap.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "telefuse needs Python 3.11 or newer; $(PYTHON) is `$(PYTHON) --version 2>&1`. Try: make $(MAKECMDGOALS) PYTHON=python3.12" >&2; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || \
	  { rm -rf $(VENV); echo "$(PYTHON) cannot make environments; on Debian: apt-get install python3-venv" >&2; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements/bootstrap.txt
	$(BIN)/uv pip sync --quiet --require-hashes --python $(BIN)/python requirements/lock.txt requirements/roads.txt || \
	  { echo "the extra roads does not install here: without it roads are unknown and their tests are skipped" >&2; \
	  $(BIN)/uv pip sync --quiet --require-hashes --python $(BIN)/python requirements/lock.txt; }
	$(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation --editable .
	@touch $@

# For tests/browser, which are skipped, visibly, where there is none. Debian's, as one that pip brings needs its libraries.
browser:
	@if command -v chromium >/dev/null; then :; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	  apt-get update --quiet=2 && DEBIAN_FRONTEND=noninteractive apt-get install --quiet=2 --yes --no-install-recommends chromium; \
	else echo "no Chromium: tests/browser will be skipped" >&2; fi

# DEMO="--drive DIR" plays a recording instead of the simulated drive; DEMO=--exit ends when done.
demo: setup
	$(BIN)/telefuse demo $(DEMO) $(ARGS)

test: setup
	$(BIN)/pytest -n $(WORKERS) --dist loadfile

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/telefuse openapi | cmp - openapi.yaml || { echo "openapi.yaml is not what the service offers: make docs" >&2; exit 1; }

bench: setup
	$(BIN)/telefuse bench --kernel
	$(BIN)/telefuse bench

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# Files that are made from the code.
docs: setup
	$(BIN)/telefuse openapi > openapi.yaml

proto: setup
	$(BIN)/python -m grpc_tools.protoc -I . --python_out=. --pyi_out=. schemas/telemetry.proto

lock: setup
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --extra parquet --group dev pyproject.toml -o requirements/lock.txt
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --constraints requirements/lock.txt --extra roads pyproject.toml -o requirements/roads.txt
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --constraints requirements/lock.txt --constraints requirements/roads.txt --extra parquet --extra roads pyproject.toml -o requirements/runtime.txt
	echo setuptools | $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --constraints requirements/lock.txt - -o requirements/build.txt
	echo uv | $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header - -o requirements/bootstrap.txt

clean:
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find core schemas service tests -name __pycache__ -prune -exec rm -rf {} +
