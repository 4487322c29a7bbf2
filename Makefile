# Every target does all its own set-up; `make demo` and `make test` are all a newcomer needs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.installed
TOOLS := $(VENV)/.tools

# Folder of the common benchmark curves; without it, speed alone is measured.
BENCH_DATA ?= ../shared/data/bench

# Bytecode is kept whatever the shell says: each process would else compile its libraries anew, torch alone for 3 s.
export PYTHONDONTWRITEBYTECODE =

.PHONY: install demo test lint bench notebooks clean

install: $(READY)

# Two builds of torch fit the project's range; the CPU one suffices. PIP_ARGS passes options on, e.g. an index of yours.
$(READY): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile $(PIP_ARGS) "torch==2.13.0" --editable .
	touch $(READY)

# What tests and checks need besides, the extra "dev"; petkin itself is left alone, so that the demo may run meanwhile.
$(TOOLS): $(READY)
	$(BIN)/python -c "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['project']['optional-dependencies']['dev'], sep='\n')" \
		| $(BIN)/python -m pip install --quiet --no-compile $(PIP_ARGS) --requirement /dev/stdin
	touch $(TOOLS)

demo: install
	rm -rf petkin-demo
	$(BIN)/petkin demo --out petkin-demo

# Two workers share the cores; libraries that take all of them for each would wait for one another. What goes out first
# is tests/conftest.py's to say.
test: $(TOOLS)
	OMP_NUM_THREADS=1 $(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder

lint: $(TOOLS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/pyright

bench: install
	$(BIN)/petkin-bench speed fit $(if $(wildcard $(BENCH_DATA)),--data $(BENCH_DATA))

# Runs every notebook and draws its picture anew, beside it.
notebooks: $(TOOLS)
	cd notebooks && for notebook in *.py; do ../$(BIN)/python "$$notebook" || exit 1; done

clean:
	rm -rf $(VENV) petkin-demo .pytest_cache .ruff_cache .hypothesis .import_linter_cache
