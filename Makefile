# make demo: plan a motion on a shipped scenario.  make test: lint, types, tests.  Both need Python and a C++ compiler only.
# make fuzz: 10,000 made-up files per reader, 100 interruptions per command.
# make wheel: a wheel from the source distribution, run where no compiler is.  make api: guides and interface as a site.
# make gallery: a page of all shipped scenarios, studies and diagnoses.  make pictures: those of the documents anew.
# make sanitize: the core under sanitizers.  make bank: 20,000 random robots, and 216 measured data sets diagnosed.
# make mutants: 22 lines made wrong, one at a time, each of which tests have to notice.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SOURCES := $(shell find ctrplan model scenarios -type f -not -name '*.pyc' -not -name '_model*' 2>/dev/null)
SCENARIO ?= scenarios/vessel.toml
OUTPUT ?= demo-output

.PHONY: demo test lint read install clean fuzz mutants wheel api gallery pictures sanitize bank bank-core bank-diagnosis

# What takes a while says so before it starts, builds included.
FIRST_BUILD = $(if $(wildcard $(VENV)/.installed),, The first time the environment is built: two to six minutes more.)

.PHONY: demo-time test-time
demo-time:
	@echo "Planning $(SCENARIO) takes half a minute or so.$(FIRST_BUILD)"
test-time:
	@echo "Lint, types and all tests take six to eighteen minutes on two processors.$(FIRST_BUILD)"

demo: demo-time install
	$(BIN)/ctrplan plan $(SCENARIO) -o $(OUTPUT)
	@echo "Open $(OUTPUT)/report.html, or look at $(OUTPUT)/plan.png; the drive plays $(OUTPUT)/trajectory.csv."

# A file shares what it makes once; where one process waits others work. Each reads all tests, which takes a third of
# the time where one that has read them before, beside the types, has left their bytecode.
test: test-time install
	@$(MAKE) --no-print-directory -j 2 lint read
	PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -n $$(( $$(nproc) + 1 )) --dist loadfile

read: install
	@PYTHONDONTWRITEBYTECODE= $(BIN)/pytest --collect-only -qq > /dev/null || true  # the tests then say why

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	cd $(VENV) && bin/mypy --config-file ../pyproject.toml  # of the installed package, which has the core's stub

install: $(VENV)/.installed

# Build requirements stay in the environment, so that rebuilding after an edit takes seconds.
$(VENV)/.deps: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python tools/requirements.py > $(VENV)/requirements.txt
	$(BIN)/pip install --quiet --disable-pip-version-check -r $(VENV)/requirements.txt
	touch $@

$(VENV)/.installed: $(VENV)/.deps $(SOURCES)
	$(BIN)/pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps .
	cp $(VENV)/lib/python*/site-packages/ctrplan/_model* ctrplan/  # for scripts started in this folder, which find ctrplan/ first
	touch $@

# What CI does a few hundred times, done 10,000 times (files) and 100 times (interruptions), and all keys, pairs of
# effects and robots of which the suite has a sample (tests/README.md): an hour or two.
fuzz: install
	CTRPLAN_FUZZ=1 $(BIN)/pytest $(shell grep -lE "from (made_up_input|effect_values) import .*(FUZZ|cases|repetitions|thorough|pairs_of|one_of_each)" tests/*/test_*.py)

# In a copy of the tree, whose core is built anew the first time: a quarter of an hour, then as long again.
mutants: install
	$(BIN)/python tools/mutants.py

wheel:
	tools/check_wheel.sh $(PYTHON)

# Warnings are errors. Nothing on the pages is loaded from the network.
api: install
	$(BIN)/pip install --quiet --disable-pip-version-check "mkdocs-material>=9.7,<10" "mkdocstrings-python>=2,<3" "latex2mathml>=3.77,<4"
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "Open build/site/index.html."

# A quarter of an hour the first time; what is there and of the same files is not made again.
gallery: install
	$(BIN)/python tools/gallery.py

# Reports and films from the gallery's plans, figures from the benchmarks that a document shows; an hour or so.
pictures: install
	$(BIN)/python tools/gallery.py --pictures
	for name in corner_shapes validation history friction_sensitivity tube_design; do $(BIN)/python benchmarks/run.py --write $$name || exit 1; done
	$(BIN)/python tools/draw_architecture.py

# The core's random solves and the laws of its parts under the address and undefined-behaviour sanitizers.
sanitize: $(VENV)/.deps
	$(BIN)/cmake -S model -B build/sanitize -G Ninja -DCMAKE_MAKE_PROGRAM=$(CURDIR)/$(BIN)/ninja -DCTR_PYTHON=OFF -DCTR_TESTS=ON \
	  -DCMAKE_BUILD_TYPE=Sanitize -DCMAKE_CXX_FLAGS="-fsanitize=address,undefined -fno-sanitize-recover=all -O1 -g" > /dev/null
	$(BIN)/cmake --build build/sanitize > /dev/null
	build/sanitize/core_test 60
	build/sanitize/parts_test 15
	build/sanitize/example_bound

bank: bank-core bank-diagnosis

# The core's laws on 20,000 random robots of 1 to 6 tubes, half of them at the ends of what can be made, those of its parts on 1,000: an hour or so.
bank-core: $(VENV)/.deps
	$(BIN)/cmake -S model -B build/core -G Ninja -DCMAKE_MAKE_PROGRAM=$(CURDIR)/$(BIN)/ninja -DCTR_PYTHON=OFF -DCTR_TESTS=ON > /dev/null
	$(BIN)/cmake --build build/core > /dev/null
	build/core/memory_test
	build/core/core_test 20000
	build/core/parts_test 1000

# Data with hidden effects, drawn from a seed, diagnosed and scored: hours; what is there is not made again. BANK_FIRST=20
# makes a small one, BANK_ROWS='"null, correlated"' one of some lines of the table, BANK_JOBS is the number of processors to give it.
BANK ?= build/bank
BANK_SEED ?= 1
BANK_FIRST ?= 1000
BANK_ROWS ?=
BANK_JOBS ?= 2
bank-diagnosis: install
	cd tests/oracles && ../../$(BIN)/python -m hidden_effects.bank make $(abspath $(BANK))/data --seed $(BANK_SEED) \
	  $(if $(BANK_ROWS),--row $(BANK_ROWS)) --first $(BANK_FIRST) --jobs $(BANK_JOBS)
	cd tests/oracles && ../../$(BIN)/python -m hidden_effects.run $(abspath $(BANK))/data $(abspath $(BANK))/diagnoses --jobs $(BANK_JOBS)
	cd tests/oracles && ../../$(BIN)/python -m hidden_effects.score $(abspath $(BANK))/data $(abspath $(BANK))/diagnoses \
	  --figure $(abspath $(BANK))/power.png --power $(abspath $(BANK))/power.json | tee $(abspath $(BANK))/table.md

clean:
	rm -rf $(VENV) build $(OUTPUT)
