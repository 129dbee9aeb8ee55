# make demo      install, compare two backends on two scenes, write a report
# make test      install, run the tests but the slow ones
# make test-all  install, run all tests
# make lint      ruff and mypy
# make docs     builds the site of documentation into out/site
# make tutorials runs the notebooks of docs/tutorials
# make examples runs the scripts of docs/examples
# make bench     benchmarks (minutes; results in docs/benchmarks.md)

VENV ?= .venv
export VENV
PY := $(VENV)/bin/python
export PYTHONNOUSERSITE := 1
# else each of some hundred processes of the tests would compile the same modules
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all lint docs tutorials examples bench setup clean

demo:
	@tools/setup.sh run
	@$(PY) tools/demo.py

# one process for each core and one thread for each, so that they do not compete
PYTEST := OMP_NUM_THREADS=1 $(PY) -m pytest -n auto --maxprocesses 8 --dist loadscope --no-loadscope-reorder

test:
	@tools/setup.sh test
	@$(PYTEST) -m "not slow" $(ARGS)

test-all:
	@tools/setup.sh test
	@$(PYTEST) $(ARGS)

lint:
	@tools/setup.sh test
	@$(PY) -m ruff check .
	@$(PY) -m ruff format --check .
	@$(PY) -m mypy

DOCS_VENV ?= .venv-docs
docs: export NO_MKDOCS_2_WARNING := 1
docs:
	@[ -x $(DOCS_VENV)/bin/mkdocs ] || { python3 -m venv $(DOCS_VENV) && $(DOCS_VENV)/bin/python -m pip install -qq --disable-pip-version-check -r requirements/docs.lock; }
	@$(DOCS_VENV)/bin/mkdocs build --strict --quiet
	@echo out/site/index.html

# each NAME.py of docs/tutorials becomes NAME.ipynb with what it shows; its kernel talks to this
# machine alone, and need not warn that it does so without encryption
tutorials: export IPYTHONDIR := $(abspath out/ipython)
tutorials:
	@tools/setup.sh test
	@tools/setup.sh tutorials
	@mkdir -p out/tutorials out/ipython/profile_default
	@echo 'get_config().IPKernelApp.log_level = "ERROR"' > out/ipython/profile_default/ipython_kernel_config.py
	@for one in docs/tutorials/*.py; do echo "$$one"; \
		PATH="$(abspath $(VENV))/bin:$$PATH" jupytext --quiet --to ipynb --set-kernel python3 --execute \
		--run-path "$(abspath out/tutorials)" "$$one" || exit 1; done

examples:
	@tools/setup.sh test
	@$(PY) -m pytest tests/docs/test_examples.py

bench:
	@tools/setup.sh test
	@$(PY) tools/bench.py

clean:
	rm -rf $(VENV) $(DOCS_VENV) out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
