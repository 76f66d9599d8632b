// What walks along paths are given and return (ctr/walk.hpp).
#pragma once

#include "arrays.hpp"
#include "ctr/walk.hpp"

// A grid of distances given by Python, kept alive.
struct Grid {
    using Values = nb::ndarray<const float, nb::numpy, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
    Values values;
    ctr::SignedDistanceField field;
};

// Of none: free space.
inline ctr::SignedDistanceField field_of(const Grid* grid) { return grid ? grid->field : ctr::SignedDistanceField(); }

// Samples by the names of ctrplan.mechanics.walk.PathSamples; corners are known to solved walks, bodies if asked for.
nb::dict to_python(std::vector<ctr::PathSample>&& samples, bool shapes);
