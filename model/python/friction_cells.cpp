#include "ctr/friction_cells.hpp"

#include "arrays.hpp"
#include "bindings.hpp"
#include "ctr/robot.hpp"
#include "unlocked.hpp"

namespace {

using Bodies = nb::ndarray<const double, nb::numpy, nb::shape<-1, -1, -1, 4>, nb::c_contig, nb::device::cpu>;
using Indices = nb::ndarray<const std::int64_t, nb::numpy, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

ctr::CellBodies bodies_of(const Bodies& bodies) {
    if (bodies.shape(1) < 2) throw ctr::InvalidInput("a cell has corners and a middle");
    return {bodies.data(), bodies.shape(0), static_cast<int>(bodies.shape(1)) - 1, bodies.shape(2)};
}

nb::tuple spread(Bodies bodies, std::size_t beyond) {
    const ctr::CellBodies given = bodies_of(bodies);
    ctr::CellSpread found = unlocked([&] { return ctr::cell_spread(given, beyond); });
    return nb::make_tuple(array(std::move(found.off), {given.cells, given.points}), array(std::move(found.reach), {given.cells, given.points}));
}

void make(ctr::PointsInCells* self, Bodies bodies, Indices points, Matrix error, Vector enough, int parts, double half, int halvings) {
    const ctr::CellBodies given = bodies_of(bodies);
    if (error.shape(0) != given.cells || error.shape(1) != given.points || enough.shape(0) != given.cells)
        throw ctr::InvalidInput("every cell has errors of all its points, and what is asked of it");
    new (self) ctr::PointsInCells(given, {points.data(), points.shape(0), parts, half, halvings}, error.data(), enough.data());
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
    m.def("cell_spread", &spread, "bodies"_a.noconvert(), "beyond"_a);
    nb::class_<ctr::PointsInCells>(m, "PointsInCells", "Least clearance of points of bodies over cells of friction states")
        .def("__init__", &make, "bodies"_a.noconvert(), "points"_a.noconvert(), "error_m"_a.noconvert(), "enough_m"_a.noconvert(), "parts"_a,
             "half_m"_a, "halvings"_a)
        .def("points", [](const ctr::PointsInCells& self) { return array(self.points()); })
        .def("needed", [](const ctr::PointsInCells& self) { return array(self.needed()); })
        .def("tell", &tell, "clearance_m"_a.noconvert())
        .def("found", [](const ctr::PointsInCells& self) {
            const std::size_t parts = self.least().size(), pairs = self.pairs();
            return nb::make_tuple(array(self.least()), array(self.unit(), {parts, pairs}), array(self.place()));
        });
}
