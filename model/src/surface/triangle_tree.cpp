#include "ctr/triangle_tree.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "ctr/robot.hpp"
#include "ctr/watch.hpp"

namespace ctr {
namespace {

constexpr std::int32_t kLeaf = 8;    // triangles at most: most of them are farther by their planes already
constexpr int kDeepest = 32;         // halvings until fewer than 2^31 triangles are one
constexpr double kNeedle = 1e-8;     // of the squares of two sides: less area than that, and a triangle is its sides
constexpr std::size_t kLook = 1024;  // points after which the work may be called off

Vec3 minus(const Vec3& a, const Vec3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Vec3 plus(const Vec3& a, const Vec3& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }

// Square of the distance from the segment between the origin and `along`.
double from_segment(const Vec3& p, const Vec3& along) {
    const double square = dot(along, along), share = square > 0 ? std::clamp(dot(p, along) / square, 0.0, 1.0) : 0.0;
    const Vec3 apart{p[0] - share * along[0], p[1] - share * along[1], p[2] - share * along[2]};
    return dot(apart, apart);
}

}  // namespace

// Square of the distance of a point, seen from the triangle's corner and at a height over its plane.
double TriangleTree::Triangle::square_from(const Vec3& p, double height) const {
    if (area == 0) return std::min({from_segment(p, ab), from_segment(p, ac), from_segment(minus(p, ab), minus(ac, ab))});
    // Areas that the point makes with two sides: negative beyond the third one. What is beyond one side is nearest to it, what is
    // beyond two to one of them.
    const double by_b = dot(cross(p, ac), normal), by_c = dot(cross(ab, p), normal), by_corner = area - by_b - by_c;
    if (by_b >= 0 && by_c >= 0 && by_corner >= 0) return height * height;
    double square = std::numeric_limits<double>::infinity();
    if (by_c < 0) square = from_segment(p, ab);
    if (by_b < 0) square = std::min(square, from_segment(p, ac));
    if (by_corner < 0) square = std::min(square, from_segment(minus(p, ab), minus(ac, ab)));
    return square;
}

namespace {

double from_box(const Vec3& p, const Vec3& low, const Vec3& high) {
    const double x = std::max(std::max(low[0] - p[0], p[0] - high[0]), 0.0);
    const double y = std::max(std::max(low[1] - p[1], p[1] - high[1]), 0.0);
    const double z = std::max(std::max(low[2] - p[2], p[2] - high[2]), 0.0);
    return x * x + y * y + z * z;
}

}  // namespace

TriangleTree::TriangleTree(const double* vertices, std::size_t vertex_count, const std::int64_t* faces, std::size_t face_count) {
    if (face_count == 0 || face_count > std::numeric_limits<std::int32_t>::max()) throw InvalidInput("a surface needs triangles, fewer than 2^31");
    auto vertex = [&](std::size_t k) -> Vec3 {
        if (faces[k] < 0 || static_cast<std::size_t>(faces[k]) >= vertex_count) throw InvalidInput("a triangle names a vertex that is not there");
        const double* p = vertices + 3 * faces[k];
        return {p[0], p[1], p[2]};
    };
    std::vector<Triangle> given(face_count);
    for (std::size_t f = 0; f < face_count; ++f) {
        const Vec3 corner = vertex(3 * f);
        const Vec3 ab = minus(vertex(3 * f + 1), corner), ac = minus(vertex(3 * f + 2), corner);
        const Vec3 across = cross(ab, ac);
        const double area = std::sqrt(dot(across, across));
        const bool is_needle = area <= kNeedle * (dot(ab, ab) + dot(ac, ac));
        const double factor = is_needle ? 0 : 1 / area;
        given[f] = {corner, ab, ac, {factor * across[0], factor * across[1], factor * across[2]}, is_needle ? 0 : area};
    }
    std::vector<std::int32_t> order(face_count);
    std::iota(order.begin(), order.end(), 0);
    root_ = divide(0, static_cast<std::int32_t>(face_count), order, given);
    for (const std::int32_t f : order) triangle_.push_back(given[f]);
}

// Triangles begin to end of the order, which it changes among them: halved across the longest side of their middles' box.
TriangleTree::Child TriangleTree::divide(std::int32_t begin, std::int32_t end, std::vector<std::int32_t>& order, const std::vector<Triangle>& given) {
    constexpr double kFar = std::numeric_limits<double>::infinity();
    Child made{{{kFar, kFar, kFar}, {-kFar, -kFar, -kFar}}, -1, begin, end};
    Box middles = made.box;
    auto middle = [&](std::int32_t f, int i) { return given[f].corner[i] + (given[f].ab[i] + given[f].ac[i]) / 3; };
    for (std::int32_t k = begin; k < end; ++k) {
        const Triangle& t = given[order[k]];
        for (const Vec3& p : {t.corner, plus(t.corner, t.ab), plus(t.corner, t.ac)})
            for (int i = 0; i < 3; ++i) {
                made.box.low[i] = std::min(made.box.low[i], p[i]);
                made.box.high[i] = std::max(made.box.high[i], p[i]);
            }
        for (int i = 0; i < 3; ++i) {
            middles.low[i] = std::min(middles.low[i], middle(order[k], i));
            middles.high[i] = std::max(middles.high[i], middle(order[k], i));
        }
    }
    if (end - begin <= kLeaf) return made;
    const Vec3 side = minus(middles.high, middles.low);
    const int axis = static_cast<int>(std::max_element(side.begin(), side.end()) - side.begin());
    const std::int32_t half = begin + (end - begin) / 2;
    std::nth_element(order.begin() + begin, order.begin() + half, order.begin() + end,
                     [&](std::int32_t a, std::int32_t b) { return middle(a, axis) < middle(b, axis); });
    made.node = static_cast<std::int32_t>(node_.size());
    node_.emplace_back();
    const Child first = divide(begin, half, order, given), second = divide(half, end, order, given);
    node_[made.node] = {{first, second}};
    return made;
}

void TriangleTree::distance(const double* points, std::size_t count, double* found) const {
    std::int32_t last = 0;
    for (std::size_t k = 0; k < count; ++k) {
        if (k % kLook == 0) Watch::look();
        const Vec3 p{points[3 * k], points[3 * k + 1], points[3 * k + 2]};
        const Triangle& t = triangle_[last];
        const Vec3 from_corner = minus(p, t.corner);
        Nearest nearest{t.square_from(from_corner, dot(from_corner, t.normal)), last};
        descend(p, nearest);
        found[k] = std::sqrt(nearest.square);
        last = nearest.triangle;
    }
}

void TriangleTree::look(const Vec3& p, const Child& leaf, Nearest& nearest) const {
    for (std::int32_t f = leaf.begin; f < leaf.end; ++f) {
        const Triangle& t = triangle_[f];
        const Vec3 from_corner = minus(p, t.corner);
        const double height = dot(from_corner, t.normal);
        if (height * height >= nearest.square) continue;
        const double square = t.square_from(from_corner, height);
        if (square < nearest.square) nearest = {square, f};
    }
}

void TriangleTree::descend(const Vec3& p, Nearest& nearest) const {
    struct Waiting {
        const Child* child;
        double square;
    };
    Waiting waiting[kDeepest + 1];
    int count = 0;
    waiting[count++] = {&root_, 0};
    while (count > 0) {
        Waiting next = waiting[--count];
        while (next.square < nearest.square) {
            if (next.child->node < 0) {
                look(p, *next.child, nearest);
                break;
            }
            const Node& node = node_[next.child->node];
            const Waiting child[2] = {{&node.child[0], from_box(p, node.child[0].box.low, node.child[0].box.high)},
                                      {&node.child[1], from_box(p, node.child[1].box.low, node.child[1].box.high)}};
            const int near = child[1].square < child[0].square;
            waiting[count++] = child[1 - near];
            next = child[near];
        }
    }
}

}  // namespace ctr
