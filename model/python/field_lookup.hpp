// Binding of bounds that are looked up.
#pragma once

#include "configurations.hpp"
#include "ctr/bound_field.hpp"

// The bound looked up on a grid (ctr/bound_field.hpp). axes: (tube, is rotation, lower, step, count), last one fastest.
class FieldLookup {
  public:
    using Values = nb::ndarray<const float, nb::numpy, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

    FieldLookup(const ctr::Robot& robot, const std::vector<std::tuple<int, bool, double, double, int>>& axes, Values values, double margin)
        : robot_(robot), values_(values), field_(robot, read(robot, axes, values), values.data(), margin) {}

    nb::object check_path(Matrix theta, Matrix l, nb::object field, Vector origin, double spacing, Matrix R_AB, Vector p_AB,
                          Vector density, Vector limit) const {
        const std::vector<ctr::Configuration> corners = configurations(theta, l, robot_.count());
        Field values;
        const ctr::SignedDistanceField sdf = distance_field(field, values, origin, spacing, R_AB, p_AB);
        return table(field_.check_path(corners, sdf, {density(0), density(1), density(2), density(3), density(4)},
                                       {limit(0), limit(1), limit(2)}));
    }

    // Rows as FieldEntry.
    nb::object sample(Matrix theta, Matrix l) const {
        const std::vector<ctr::Configuration> all = configurations(theta, l, robot_.count());
        std::vector<double> out;
        for (const ctr::Configuration& q : all) {
            const ctr::FieldEntry entry = field_.sample(q);
            const float* numbers = reinterpret_cast<const float*>(&entry);
            out.insert(out.end(), numbers, numbers + ctr::kFieldFloats);
        }
        return array(std::move(out), {all.size(), static_cast<std::size_t>(ctr::kFieldFloats)});
    }

  private:
    static std::vector<ctr::FieldAxis> read(const ctr::Robot& robot, const std::vector<std::tuple<int, bool, double, double, int>>& given,
                                            const Values& values) {
        std::vector<ctr::FieldAxis> axes;
        std::size_t points = 1;
        for (const auto& [tube, rotation, lower, step, count] : given) {
            if (tube < (rotation ? 1 : 0) || tube >= robot.count() || count < 2 || !(step > 0)) throw ctr::InvalidInput("an axis of the bound field is malformed");
            axes.push_back({tube, rotation, lower, step, count});
            points *= static_cast<std::size_t>(count);
        }
        if (axes.size() > ctr::kMostAxes || values.shape(0) != points || values.shape(1) != ctr::kFieldFloats)
            throw ctr::InvalidInput("the values of the bound field do not fit its axes");
        return axes;
    }

    ctr::Robot robot_;
    Values values_;
    ctr::BoundField field_;
};
