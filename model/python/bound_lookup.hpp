// Bounds looked up on a grid whose values Python keeps (ctr/bound_field.hpp).
#pragma once

#include <tuple>
#include <vector>

#include "arrays.hpp"
#include "ctr/bound_field.hpp"

class FieldLookup {
  public:
    using Values = nb::ndarray<const float, nb::numpy, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
    using Axes = std::vector<std::tuple<int, bool, double, double, int>>;  // tube, is rotation, lower, step, count; last one fastest

    FieldLookup(const ctr::Robot& robot, const Axes& axes, Values values, double margin);
    nb::object sample(Matrix theta, Matrix l) const;
    nb::dict check_path(Matrix theta, Matrix l, const struct Grid* grid, const ctr::PathDensity& density, const ctr::PathLimits& limits) const;

  private:
    ctr::Robot robot_;
    Values values_;
    ctr::BoundField field_;
};

// Rows of numbers, see entry_columns().
nb::object to_python(const std::vector<ctr::FieldEntry>& entries);
