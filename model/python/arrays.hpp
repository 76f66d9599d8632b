// Between numpy and the core: arrays in, and values handed over to arrays.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "ctr/mesh.hpp"
#include "ctr/shape.hpp"

namespace nb = nanobind;
using namespace nb::literals;

using Vector = nb::ndarray<const double, nb::numpy, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<const double, nb::numpy, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Tensor = nb::ndarray<const double, nb::numpy, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// Hands values over to numpy, without a copy.
template <class Value, class Element>
nb::object hand_over(std::vector<Element>&& values, std::initializer_list<std::size_t> shape) {
    auto* owned = new std::vector<Element>(std::move(values));
    nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<Element>*>(p); });
    return nb::cast(nb::ndarray<nb::numpy, Value>(reinterpret_cast<Value*>(owned->data()), shape, owner));
}

inline nb::object array(std::vector<double> values, std::initializer_list<std::size_t> shape) {
    return hand_over<double>(std::move(values), shape);
}
inline nb::object array(std::vector<double> values) {
    const std::size_t count = values.size();
    return hand_over<double>(std::move(values), {count});
}
inline nb::object array(std::vector<ctr::Vec3> values) {
    const std::size_t count = values.size();
    return hand_over<double>(std::move(values), {count, 3});
}
inline nb::object array(std::vector<std::array<double, 9>> values) {
    const std::size_t count = values.size();
    return hand_over<double>(std::move(values), {count, 3, 3});
}
inline nb::object array(const std::vector<ctr::Status>& values) {
    std::vector<std::int64_t> numbers;
    for (ctr::Status status : values) numbers.push_back(static_cast<int>(status));
    return hand_over<std::int64_t>(std::move(numbers), {values.size()});
}

// A member of every element of a list.
template <class Value, class Element, class Read>
std::vector<Value> column(const std::vector<Element>& all, const Read& read) {
    std::vector<Value> values;
    values.reserve(all.size());
    for (const Element& one : all) values.push_back(read(one));
    return values;
}

// By the name that ctrplan.mechanics knows it by.
inline ctr::Accuracy accuracy(const std::string& name) {
    if (name == "search") return ctr::Accuracy::search();
    if (name == "certificate") return ctr::Accuracy::certificate();
    if (name == "exact") return ctr::Accuracy::exact_geometry();
    throw ctr::InvalidInput("there is no accuracy \"" + name + "\"");
}

