#include <algorithm>
#include <cmath>
#include <limits>

#include "ctr/friction_cells.hpp"
#include "ctr/robot.hpp"
#include "ctr/watch.hpp"

namespace ctr {

double clearance_beside(double clearance, double half) {
    return clearance > half ? std::sqrt(clearance * clearance - half * half) : clearance - half;
}

PointsInCells::PointsInCells(const CellBodies& bodies, const Asked& asked, const double* error, const double* enough)
    : pairs_(0), corner_count_(bodies.corners), half_(asked.half) {
    while (1 << pairs_ < bodies.corners) ++pairs_;
    if (1 << pairs_ != bodies.corners || bodies.points == 0) throw InvalidInput("a cell has 2^P corners, whose bodies have points");
    if (asked.parts != 1 && (asked.parts < 2 || asked.parts % 2)) throw InvalidInput("a body is looked at in one part or in an even number of them");
    const std::size_t all = bodies.cells * bodies.points, parts = asked.parts * asked.count;
    for (std::size_t k = 0; k < asked.count; ++k)
        if (asked.point[k] < 0 || static_cast<std::size_t>(asked.point[k]) >= all) throw InvalidInput("a point is asked for that no cell has");
    most_ = asked.halvings * pairs_;
    error_.resize(parts), enough_.resize(parts);
    for (std::size_t part = 0; part < parts; ++part) {
        const std::size_t point = asked.point[part % asked.count];
        error_[part] = error[point];
        enough_[part] = enough[point / bodies.points];
    }
    gather(bodies, asked);
    measure_moves();
    least_.assign(parts, std::numeric_limits<double>::infinity());
    at_.assign(parts * pairs_, 0.5);
    place_.assign(parts, Vec3{0, 0, 0});
    index_.resize(parts);
    for (std::size_t part = 0; part < parts; ++part) index_[part] = part;
    low_.assign(parts * pairs_, 0.0), size_.assign(parts * pairs_, 1.0);
    ask();
}

// Each part stands in the middle of its piece of the body between a point and the one before it, then the one after it.
void PointsInCells::gather(const CellBodies& bodies, const Asked& asked) {
    corners_.resize(4 * asked.parts * asked.count * corner_count_);
    double* to = corners_.data();
    for (int part = 0; part < asked.parts; ++part) {
        const int half = asked.parts / 2;
        const double share = asked.parts == 1 ? 0 : (part % half + 0.5) / asked.parts;
        for (std::size_t k = 0; k < asked.count; ++k) {
            const std::size_t cell = asked.point[k] / bodies.points, at = asked.point[k] % bodies.points;
            const std::size_t beside = part < half ? (at == 0 ? at : at - 1) : std::min(at + 1, bodies.points - 1);
            for (int c = 0; c < corner_count_; ++c) {
                const double *own = bodies.point(cell, c, at), *other = bodies.point(cell, c, beside);
                for (int i = 0; i < 4; ++i) *to++ = own[i] + share * (other[i] - own[i]);
            }
        }
    }
}

// How far a part's surface can move over its cell by each pair: the longest edges, radii counted.
void PointsInCells::measure_moves() {
    const std::size_t parts = error_.size();
    moves_.assign(parts * pairs_, 0.0);
    for (std::size_t part = 0; part < parts; ++part)
        for (int pair = 0; pair < pairs_; ++pair) {
            const int high = 1 << (pairs_ - 1 - pair);
            double& most = moves_[part * pairs_ + pair];
            for (int c = 0; c < corner_count_; ++c) {
                if (c & high) continue;
                const double *a = corner(part, c), *b = corner(part, c | high);
                const double x = b[0] - a[0], y = b[1] - a[1], z = b[2] - a[2];
                most = std::max(most, std::sqrt(x * x + y * y + z * z) + std::fabs(b[3] - a[3]));
            }
        }
}

void PointsInCells::ask() {
    const std::size_t boxes = index_.size();
    points_.resize(boxes), radius_.resize(boxes), slack_.resize(boxes), needed_.resize(boxes);
    for (std::size_t box = 0; box < boxes; ++box) {
        const std::size_t part = index_[box];
        const double *low = low_.data() + box * pairs_, *size = size_.data() + box * pairs_;
        double at[4] = {0, 0, 0, 0}, slack = 0;
        for (int c = 0; c < corner_count_; ++c) {
            double weight = 1;
            for (int pair = 0; pair < pairs_; ++pair) {
                const double unit = low[pair] + size[pair] / 2;
                weight *= c >> (pairs_ - 1 - pair) & 1 ? unit : 1 - unit;
            }
            for (int i = 0; i < 4; ++i) at[i] += weight * corner(part, c)[i];
        }
        for (int pair = 0; pair < pairs_; ++pair) slack += moves_[part * pairs_ + pair] * size[pair] / 2;
        points_[box] = {at[0], at[1], at[2]};
        radius_[box] = at[3];
        slack_[box] = slack;
        needed_[box] = enough_[part] + error_[part] + at[3] + slack + half_;
    }
}

void PointsInCells::tell(const double* clearance) {
    Watch::look();
    std::vector<std::size_t> open;
    for (std::size_t box = 0; box < index_.size(); ++box) {
        const std::size_t part = index_[box];
        const double clear = clearance_beside(clearance[box], half_) - error_[part] - radius_[box];
        const bool is_enough = clear - slack_[box] >= enough_[part], is_short = !(clear >= enough_[part]);
        if (!is_enough && !is_short && level_ < most_) {
            open.push_back(box);
            continue;
        }
        const double found = is_short ? clear : clear - slack_[box];  // less than asked for says enough
        if (!(found < least_[part])) continue;
        least_[part] = found;
        place_[part] = points_[box];
        for (int pair = 0; pair < pairs_; ++pair) at_[part * pairs_ + pair] = low_[box * pairs_ + pair] + size_[box * pairs_ + pair] / 2;
    }
    ++level_;
    halve(open);
    ask();
}

// Each along the pair whose states move its part most; none of a part of which less than enough was found.
void PointsInCells::halve(const std::vector<std::size_t>& boxes) {
    std::vector<std::size_t> index;
    std::vector<double> low, size;
    for (std::size_t box : boxes) {
        const std::size_t part = index_[box];
        if (!(least_[part] >= enough_[part])) continue;
        int along = 0;
        double most = -1;
        for (int pair = 0; pair < pairs_; ++pair) {
            const double moves = moves_[part * pairs_ + pair] * size_[box * pairs_ + pair];
            if (moves > most) most = moves, along = pair;
        }
        for (int half = 0; half < 2; ++half) {
            index.push_back(part);
            for (int pair = 0; pair < pairs_; ++pair) {
                const double whole = size_[box * pairs_ + pair], own = pair == along ? whole / 2 : whole;
                low.push_back(low_[box * pairs_ + pair] + (pair == along && half ? own : 0.0));
                size.push_back(own);
            }
        }
    }
    index_.swap(index), low_.swap(low), size_.swap(size);
}

}  // namespace ctr
