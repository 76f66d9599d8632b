// Distance of points to a surface of triangles, by a tree of boxes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "ctr/curve.hpp"

namespace ctr {

class TriangleTree {
public:
    // vertices: rows of three coordinates; faces: rows of three vertices. Throws InvalidInput without triangles, or for a vertex
    // that is not there.
    TriangleTree(const double* vertices, std::size_t vertex_count, const std::int64_t* faces, std::size_t face_count);

    // Of points (count, 3); fastest where each is near the one before it.
    void distance(const double* points, std::size_t count, double* found) const;

private:
    struct Triangle {
        Vec3 corner, ab, ac;
        Vec3 normal;  // of length 1, or 0 of needles
        double area;  // twice that of the triangle, or 0 of needles
        double square_from(const Vec3& p, double height) const;
    };
    struct Box {
        Vec3 low, high;
    };
    struct Child {
        Box box;
        std::int32_t node = -1;  // where it is divided; negative: triangles
        std::int32_t begin = 0, end = 0;
    };
    struct Node {
        Child child[2];
    };
    struct Nearest {
        double square;
        std::int32_t triangle;
    };

    Child divide(std::int32_t begin, std::int32_t end, std::vector<std::int32_t>& order, const std::vector<Triangle>& given);
    void look(const Vec3& p, const Child& leaf, Nearest& nearest) const;
    void descend(const Vec3& p, Nearest& nearest) const;

    std::vector<Triangle> triangle_;  // those of a leaf one after the other
    std::vector<Node> node_;
    Child root_;
};

}  // namespace ctr
