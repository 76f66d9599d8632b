// Bodies in cells of friction states, interpolated multilinearly between those of a cell's corners.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "ctr/curve.hpp"

namespace ctr {

// Bodies of N points each, of the 2^P corners of every cell (the last pair fastest, low before high) and of its middle.
struct CellBodies {
    const double* values = nullptr;  // [cell][corner, then the middle][point][x, y, z, radius], m
    std::size_t cells = 0;
    int corners = 1;
    std::size_t points = 0;

    const double* point(std::size_t cell, int corner, std::size_t k) const {
        return values + 4 * ((cell * (static_cast<std::size_t>(corners) + 1) + corner) * points + k);
    }
};

// [cell][point], m.
struct CellSpread {
    std::vector<double> off;    // largest distance of the middle's points from the mean of the corners', from the base up to `beyond` further out
    std::vector<double> reach;  // how far a corner's surface lies at most from the middle's centreline
};

CellSpread cell_spread(const CellBodies& bodies, std::size_t beyond);

// A configuration without friction and in its sign corners (high before low, the last pair fastest).
struct CornerBodies {
    const double* values = nullptr;  // [without friction, then the corners][point][x, y, z], m; consecutive
    std::ptrdiff_t point_stride = 3;  // from one point to the next
    int pairs = 1;
    std::size_t points = 0;

    const double* at(std::size_t shape, std::size_t k) const {
        return values + point_stride * static_cast<std::ptrdiff_t>(shape * points + k);
    }
};

// How far bodies of friction states lie from the multilinear interpolation of the corners' bodies, beside a configuration.
struct Bend {
    const double* share = nullptr;   // [point] of the body's length, 0 to 1
    const double* values = nullptr;  // [state][point][x, y, z], m
    std::size_t points = 0;
};

// What is said of bodies that were not solved themselves, as parts of what is known beside them.
struct Doubts {
    double change = 0;   // of the difference of both bends
    double bend = 0;     // of the bend
    double spread = 0;   // of the largest distance of a corner from the frictionless body
    std::size_t beyond = 0;  // points further out whose doubt counts too
};

struct BodiesBetween {
    std::vector<double> bodies;  // [state][point][x, y, z], m
    std::vector<double> doubt;   // [state][point], m
};

// Bodies in states phi [state][pair], -1 to 1, of a configuration that lies `share` of the way from one whose states are solved
// to another one. Not a number where one of them has no body.
BodiesBetween bodies_between(const CornerBodies& own, const double* phi, std::size_t states, const Bend& first, const Bend& last, double share,
                             const Doubts& doubts);

// Looks for the least clearance of single points of bodies over all states of their cells.
//
// Boxes of states are halved along the pair that moves their point most, until it has enough clearance all over the box or surely
// has not, or until the point moves by no more than a tolerance in it; a point of too many boxes is short of it. A point is farthest
// from a box's middle in one of its vertices, for it is linear in every pair, and clearance is 1-Lipschitz. Whoever
// knows clearances is asked for those of `points()`, exact where they are below `needed()`, and tells them.
class PointsInCells {
  public:
    struct Asked {
        const std::int64_t* point = nullptr;  // of all cells, counted one after the other
        std::size_t count = 0;
        int parts = 1;                        // of the body around each point, looked at one by one: 1 or even
        double half = 0;                      // of the body that one of them stands for, on both sides, m
        double within = 0;                    // that a box may be short of enough by its size alone, and is not halved, m
    };
    // error [cell][point] is taken off; `enough` [cell] is what is asked for, m.
    PointsInCells(const CellBodies& bodies, const Asked& asked, const double* error, const double* enough);

    const std::vector<Vec3>& points() const { return points_; }  // none once all is known
    const std::vector<double>& needed() const { return needed_; }
    void tell(const double* clearance);  // one for each of `points()`, radii not taken off

    int pairs() const { return pairs_; }
    // Part by part, each of all points asked for: parts * count.
    const std::vector<double>& least() const { return least_; }  // lower bound, m; less than enough says only that
    const std::vector<double>& unit() const { return at_; }      // [part][pair] where it was found, 0 to 1 of the cell
    const std::vector<Vec3>& place() const { return place_; }    // likewise

  private:
    const double* corner(std::size_t part, int corner) const { return corners_.data() + 4 * (part * corner_count_ + corner); }
    void gather(const CellBodies& bodies, const Asked& asked);
    void measure_moves();
    double slack(std::size_t part, const double* size, const std::vector<Vec3>& slope) const;
    void halve(const std::vector<std::size_t>& boxes);
    void keep_less(std::size_t box, double found);
    void ask();

    int pairs_, corner_count_;
    double half_, within_;
    std::vector<double> corners_;                  // [part][corner][x, y, z, radius]
    std::vector<double> error_, enough_, moves_;   // [part], [part], [part][pair]
    std::vector<double> turns_, mixed_;            // [part][pair] of the radius; [part][pairs], a bit for each
    std::vector<std::size_t> index_;               // of the part of each box
    std::vector<double> low_, size_;               // [box][pair]
    std::vector<Vec3> points_, place_;
    std::vector<double> radius_, slack_, needed_;  // [box]
    std::vector<double> least_, at_;
};

// Lower bound of the clearance within `half` of a point with a clearance, its radius not taken off.
double clearance_beside(double clearance, double half);

}  // namespace ctr
