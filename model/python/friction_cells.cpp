#include "ctr/friction_cells.hpp"

#include <algorithm>
#include <optional>

#include "arrays.hpp"
#include "bindings.hpp"
#include "ctr/robot.hpp"
#include "unlocked.hpp"

namespace {

using Bodies = nb::ndarray<const double, nb::numpy, nb::shape<-1, -1, -1, 4>, nb::c_contig, nb::device::cpu>;
using Indices = nb::ndarray<const std::int64_t, nb::numpy, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

using Shapes = nb::ndarray<const double, nb::numpy, nb::shape<-1, -1, 3>, nb::device::cpu>;
using OneBody = nb::ndarray<const double, nb::numpy, nb::shape<-1, 3>, nb::device::cpu>;
using OneRow = nb::ndarray<const double, nb::numpy, nb::ndim<1>, nb::device::cpu>;
using Bends = nb::ndarray<const double, nb::numpy, nb::shape<-1, -1, 3>, nb::c_contig, nb::device::cpu>;

ctr::CellBodies bodies_of(const Bodies& bodies) {
    if (bodies.shape(1) < 2) throw ctr::InvalidInput("a cell has corners and a middle");
    return {bodies.data(), bodies.shape(0), static_cast<int>(bodies.shape(1)) - 1, bodies.shape(2)};
}

nb::tuple spread(Bodies bodies, std::size_t beyond) {
    const ctr::CellBodies given = bodies_of(bodies);
    ctr::CellSpread found = unlocked([&] { return ctr::cell_spread(given, beyond); });
    return nb::make_tuple(array(std::move(found.off), {given.cells, given.points}), array(std::move(found.reach), {given.cells, given.points}));
}

ctr::CornerBodies corner_bodies(const Shapes& shapes, std::size_t pairs) {
    const std::size_t points = shapes.shape(1);
    if (pairs < 1 || shapes.shape(0) != (std::size_t{1} << pairs) + 1) throw ctr::InvalidInput("there is a body without friction and one of every corner");
    if (points < 2 || shapes.stride(2) != 1 || shapes.stride(0) != static_cast<std::int64_t>(points) * shapes.stride(1))
        throw ctr::InvalidInput("bodies follow one another in memory, and have two points at least");
    return {shapes.data(), shapes.stride(1), static_cast<int>(pairs), points};
}

ctr::Bend bend_of(const Vector& share, const Bends& bend, std::size_t states) {
    if (bend.shape(0) != states || bend.shape(1) != share.shape(0) || bend.shape(1) < 2)
        throw ctr::InvalidInput("every state has a bend at all shares of the length");
    return {share.data(), bend.data(), bend.shape(1)};
}

nb::tuple between(Shapes shapes, Matrix phi, Vector first_share, Bends first, Vector last_share, Bends last, double share, std::array<double, 3> doubts,
                  std::size_t beyond) {
    const std::size_t states = phi.shape(0);
    const ctr::CornerBodies own = corner_bodies(shapes, phi.shape(1));
    const ctr::Bend ends[] = {bend_of(first_share, first, states), bend_of(last_share, last, states)};
    const ctr::Doubts said{doubts[0], doubts[1], doubts[2], beyond};
    ctr::BodiesBetween found = unlocked([&] { return ctr::bodies_between(own, phi.data(), states, ends[0], ends[1], share, said); });
    return nb::make_tuple(array(std::move(found.bodies), {states, own.points, 3}), array(std::move(found.doubt), {states, own.points}));
}

// A body as it is written into those of its cell. It holds its arrays, which may be copies of what was given.
struct Gathered {
    OneBody body;
    OneRow radius;
    std::optional<OneRow> doubt;

    std::size_t points() const { return body.shape(0); }
    double coordinate(std::size_t k, int i) const { return body.data()[static_cast<std::int64_t>(k) * body.stride(0) + i * body.stride(1)]; }
    double reach(std::size_t k) const { return at(radius, k) + (doubt ? at(*doubt, k) : 0.0); }

  private:
    static double at(const OneRow& row, std::size_t k) { return row.data()[static_cast<std::int64_t>(k) * row.stride(0)]; }
};

Gathered gathered_of(nb::handle body, nb::handle radius, nb::handle doubt) {
    Gathered one{nb::cast<OneBody>(body), nb::cast<OneRow>(radius), std::nullopt};
    if (!doubt.is_none()) one.doubt = nb::cast<OneRow>(doubt);
    const std::size_t points = one.points();
    if (points == 0 || one.radius.shape(0) != points || (one.doubt && one.doubt->shape(0) != points))
        throw ctr::InvalidInput("a body has a radius, and a doubt if any, at every point");
    return one;
}

// What is too short stands at its tip for the rest.
nb::object cell_bodies(nb::list bodies, nb::list radii, nb::list doubts, std::size_t of_cell) {
    const std::size_t count = nb::len(bodies);
    if (of_cell < 2 || count % of_cell != 0 || nb::len(radii) * of_cell != count || nb::len(doubts) != count)
        throw ctr::InvalidInput("every cell has its bodies and one row of radii");
    std::vector<Gathered> given;
    std::size_t longest = 0;
    for (std::size_t k = 0; k < count; ++k) {
        given.push_back(gathered_of(bodies[k], radii[k / of_cell], doubts[k]));
        longest = std::max(longest, given.back().points());
    }
    std::vector<double> values = unlocked([&] {
        std::vector<double> written(count * longest * 4);
        double* at = written.data();
        for (const Gathered& one : given) {
            for (std::size_t k = 0; k < longest; ++k, at += 4) {
                const std::size_t row = std::min(k, one.points() - 1);
                for (int i = 0; i < 3; ++i) at[i] = one.coordinate(row, i);
                at[3] = one.reach(row);
            }
        }
        return written;
    });
    return array(std::move(values), {count / of_cell, of_cell, longest, 4});
}

void make(ctr::PointsInCells* self, Bodies bodies, Indices points, Matrix error, Vector enough, int parts, double half, double within) {
    const ctr::CellBodies given = bodies_of(bodies);
    if (error.shape(0) != given.cells || error.shape(1) != given.points || enough.shape(0) != given.cells)
        throw ctr::InvalidInput("every cell has errors of all its points, and what is asked of it");
    new (self) ctr::PointsInCells(given, {points.data(), points.shape(0), parts, half, within}, error.data(), enough.data());
}

void tell(ctr::PointsInCells& self, Vector clearance) {
    if (clearance.shape(0) != self.points().size()) throw ctr::InvalidInput("every point has one clearance");
    unlocked([&] {
        self.tell(clearance.data());
        return 0;
    });
}

}  // namespace

void bind_friction_cells(nb::module_& m) {
    m.def("bodies_between", &between, "shapes_m"_a.noconvert(), "phi"_a.noconvert(), "first_share"_a.noconvert(), "first_m"_a.noconvert(),
          "last_share"_a.noconvert(), "last_m"_a.noconvert(), "share"_a, "doubts"_a, "beyond"_a);
    m.def("cell_bodies", &cell_bodies, "bodies_m"_a, "radii_m"_a, "doubts_m"_a, "of_cell"_a);
    m.def("cell_spread", &spread, "bodies"_a.noconvert(), "beyond"_a);
    nb::class_<ctr::PointsInCells>(m, "PointsInCells", "Least clearance of points of bodies over cells of friction states")
        .def("__init__", &make, "bodies"_a.noconvert(), "points"_a.noconvert(), "error_m"_a.noconvert(), "enough_m"_a.noconvert(), "parts"_a,
             "half_m"_a, "within_m"_a)
        .def("points", [](const ctr::PointsInCells& self) { return array(self.points()); })
        .def("needed", [](const ctr::PointsInCells& self) { return array(self.needed()); })
        .def("tell", &tell, "clearance_m"_a.noconvert())
        .def("found", [](const ctr::PointsInCells& self) {
            const std::size_t parts = self.least().size(), pairs = self.pairs();
            return nb::make_tuple(array(self.least()), array(self.unit(), {parts, pairs}), array(self.place()));
        });
}
