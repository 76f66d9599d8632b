// Work in the core without the interpreter's lock, which Ctrl-C and whoever is told its progress can end.
#pragma once

#include <nanobind/nanobind.h>

#include <optional>

#include "ctr/watch.hpp"

namespace nb = nanobind;

// What work returns. Every tenth of a second signals are looked at and `progress` is told the finished share; what either
// raises ends the work.
template <class Work>
auto unlocked(const Work& work, const nb::object& progress = nb::none()) {
    std::optional<nb::python_error> raised;
    const bool is_told = !progress.is_none();
    auto goes_on = [&](double share) {
        const nb::gil_scoped_acquire lock;
        try {
            if (PyErr_CheckSignals() != 0) throw nb::python_error();
            if (is_told) progress(share);
        } catch (const nb::python_error& error) {
            raised.emplace(error);
        }
        return !raised.has_value();
    };
    try {
        const nb::gil_scoped_release release;
        const ctr::Watch watch(goes_on);
        return work();
    } catch (const ctr::Interrupted&) {
        throw nb::python_error(*raised);
    }
}
