// Shapes as the core keeps them, by the names of ctrplan.mechanics.shapes; their arrays are views, made when they are asked for.
#pragma once

#include <nanobind/stl/shared_ptr.h>

#include <memory>

#include "arrays.hpp"
#include "ctr/shape.hpp"

inline nb::object to_python(ctr::Shape&& shape) { return nb::cast(std::move(shape)); }
