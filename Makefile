# make demo: set up and run the main job.   make test: set up, check and test.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: setup warm demo test quick style lint experiments proof bench docs fuzz faults clean

setup: $(BIN)/.installed

$(BIN)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet --editable ".[logs]" --group dev
	touch $@

# Compiles the programs of two trials and of the demo once, into the user's cache: two minutes, after
# which these trials take half as long and `make demo` a third less. Other logs compile their own.
warm: setup
	$(BIN)/diffsea trial otter --manoeuvre zigzag -o out/warm/zigzag
	$(BIN)/diffsea trial otter --manoeuvre turning-circle -o out/warm/circle
	$(BIN)/diffsea diagnose examples/demo/usv.toml examples/demo/recordings/*.csv \
	  --test examples/demo/held_out/*.csv -o out/warm/demo

demo: setup
	$(BIN)/diffsea diagnose examples/demo/usv.toml examples/demo/recordings/*.csv \
	  --test examples/demo/held_out/*.csv -o out/demo

style: setup
	$(BIN)/ruff check src tests experiments benchmarks docs/site docs/notebooks
	$(BIN)/ruff format --check src tests experiments benchmarks docs/site docs/notebooks
	$(BIN)/lint-imports

lint: style
	$(BIN)/pyright --threads 2

# Types of what is not run here: tests tell of their own mistakes.
test: style
	$(BIN)/pyright --threads 2 src experiments benchmarks
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --durations 30 \
	  -m "not proof and not experiment"

quick: style
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not slow and not experiment and not proof"

experiments: setup
	$(BIN)/python -m experiments.every

# The longest tests and those of experiments; then the proof on real recordings, which lie where
# experiments/DATA.md says: hours; goes on where it was stopped.
proof: lint
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "proof or experiment"
	$(BIN)/python -m experiments.concealed_real.run
	$(BIN)/python -m experiments.concealed_real.score

# Speeds beside what the machine can do; BENCH=engine|jacobian|fit|diagnosis|sweep|startup|growth|
# commands|scale|gpu for a part.
bench: setup
	$(BIN)/python -m benchmarks.run $(BENCH)

# The site, in out/site: links checked, nothing fetched from elsewhere. Its pictures and notebooks
# are made anew where the sources changed, and kept in out/site-cache.
docs: setup
	$(BIN)/python -m pip install --quiet --group docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet -f docs/site/mkdocs.yml

# Hostile inputs to every reader, in processes of their own; what breaks is kept in out/fuzz.
fuzz: setup
	$(BIN)/python -m tests.fuzz.run --inputs $(or $(INPUTS),1000)

# Every call for a file of every command made to fail; a sweep, a fit and a diagnosis killed at
# random moments, each so many times: hours, which go on where they were stopped.
faults: setup
	$(BIN)/python -m tests.faults.run
	$(BIN)/python -m tests.faults.kill --rounds $(or $(ROUNDS),200)

clean:
	rm -rf $(VENV) out
