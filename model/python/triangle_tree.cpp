#include "ctr/triangle_tree.hpp"

#include "arrays.hpp"
#include "bindings.hpp"
#include "ctr/robot.hpp"
#include "unlocked.hpp"

namespace {

using Faces = nb::ndarray<const std::int64_t, nb::numpy, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Points = nb::ndarray<const double, nb::numpy, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;

nb::object distance(const ctr::TriangleTree& tree, Points points) {
    std::vector<double> found(points.shape(0));
    unlocked([&] {
        tree.distance(points.data(), found.size(), found.data());
        return 0;
    });
    return array(std::move(found));
}

}  // namespace

void bind_triangle_tree(nb::module_& m) {
    nb::class_<ctr::TriangleTree>(m, "TriangleTree", "Distance of points to a surface of triangles")
        .def(
            "__init__",
            [](ctr::TriangleTree* self, Points vertices, Faces faces) {
                new (self) ctr::TriangleTree(vertices.data(), vertices.shape(0), faces.data(), faces.shape(0));
            },
            "vertices_m"_a.noconvert(), "faces"_a.noconvert())
        .def("distance", &distance, "points_m"_a.noconvert());
}
