// Binding of path histories.
#pragma once

#include <limits>
#include <mutex>

#include "configurations.hpp"
#include "ctr/history.hpp"

// A simulation of what happens along a joint path (ctr/history.hpp).
class PathHistory {
  public:
    PathHistory(const ctr::Robot& robot, const ctr::Accuracy& accuracy, const ctr::HistoryOptions& options)
        : robot_(robot), history_(robot, accuracy, options) {}

    int start(Vector theta, Vector l, Vector phi) {
        if (phi.shape(0) != robot_.pairs.size()) throw ctr::InvalidInput("phi needs one value per neighbouring pair");
        const ctr::Configuration q = valid_configuration(robot_, theta, l);
        std::vector<double> friction(phi.data(), phi.data() + phi.shape(0));
        friction.resize(std::max<std::size_t>(friction.size(), 1));
        nb::gil_scoped_release release;
        const std::lock_guard<std::mutex> lock(mutex_);
        return static_cast<int>(history_.start(q, friction));
    }

    // status, residual, steps, snaps, work, growth of elastic energy, growth of breakaway energy, loss, smallest loss.
    nb::tuple advance(Vector theta, Vector l) {
        const ctr::Configuration q = valid_configuration(robot_, theta, l);
        const std::unique_lock<std::mutex> lock = hold();
        int status;
        {
            nb::gil_scoped_release release;
            status = static_cast<int>(history_.advance(q));
        }
        const ctr::EnergyBalance& energy = history_.energy();
        return nb::make_tuple(status, history_.residual(), history_.steps(), history_.snaps(), energy.work, energy.elastic,
                              energy.breakaway, energy.loss, energy.smallest_loss);
    }

    // Waypoint after waypoint; columns: status, snaps, tip (3), tangent (3), then per pair phi averaged by normal force.
    // Rows after a failure are NaN.
    nb::object follow(Matrix theta, Matrix l) {
        const std::vector<ctr::Configuration> path = valid_configurations(robot_, theta, l);
        const std::size_t rows = path.size(), columns = 8 + robot_.pairs.size();
        std::vector<double> out(rows * columns, std::numeric_limits<double>::quiet_NaN());
        {
            nb::gil_scoped_release release;
            const std::lock_guard<std::mutex> lock(mutex_);
            ctr::Backbone backbone;
            ctr::BackboneTracer tracer;
            for (std::size_t k = 0; k < rows; ++k) {
                double* row = &out[k * columns];
                row[0] = static_cast<int>(history_.advance(path[k]));
                if (history_.status() == ctr::Status::failed) break;
                tracer.trace(history_.solver(), history_.state(), 0, 1, path[k].l.back(), &backbone);
                row[1] = history_.snaps();
                const ctr::Vec3 tangent = backbone.frame.back().tangent();
                for (int i = 0; i < 3; ++i) {
                    row[2 + i] = backbone.frame.back().p[i];
                    row[5 + i] = tangent[i];
                }
                history_.mean_phi(row + 8);
            }
        }
        return array(std::move(out), {rows, columns});
    }

    nb::dict shape() const {
        const std::unique_lock<std::mutex> lock = hold();
        ctr::Shape shape = ctr::make_shape(history_.solver(), history_.state(), 0, history_.configuration());
        shape.status = history_.status();
        shape.residual = history_.residual();
        shape.stability = std::numeric_limits<double>::quiet_NaN();
        return to_python(shape);
    }

    // Per pair, outermost first: s, phi, psi, normal force of every contact.
    nb::list friction() const {
        const std::unique_lock<std::mutex> lock = hold();
        const ctr::KernelProblem& pb = history_.solver().mesh().problem();
        nb::list pairs;
        const ctr::Shape shape = ctr::make_shape(history_.solver(), history_.state(), 0, history_.configuration());
        for (int pair = 0; pair + 1 < pb.tubes; ++pair) {
            std::vector<double> phi, psi;
            for (int k = 0; k < pb.contacts; ++k)
                if (pb.contact_pair[k] == pb.tubes - 2 - pair) {
                    phi.push_back(history_.phi()[k]);
                    psi.push_back(history_.psi()[k]);
                }
            pairs.append(nb::make_tuple(array(shape.contacts[pair].s), array(phi), array(psi), array(shape.contacts[pair].force)));
        }
        return pairs;
    }

    // Tip (3) and tangent (3) at friction states phi on the branch that the history is on; NaN where it ends before.
    nb::object beside(Vector phi) {
        if (phi.shape(0) != robot_.pairs.size()) throw ctr::InvalidInput("phi needs one value per neighbouring pair");
        const std::vector<double> friction(phi.data(), phi.data() + phi.shape(0));
        std::vector<double> out(6, std::numeric_limits<double>::quiet_NaN());
        {
            nb::gil_scoped_release release;
            const std::lock_guard<std::mutex> lock(mutex_);
            ctr::Backbone backbone;
            if (history_.solve_beside(friction, backbone)) {
                const ctr::Vec3 tangent = backbone.frame.back().tangent();
                for (int i = 0; i < 3; ++i) {
                    out[i] = backbone.frame.back().p[i];
                    out[3 + i] = tangent[i];
                }
            }
        }
        return array(std::move(out), {6});
    }

    ctr::History::State save() const {
        const std::unique_lock<std::mutex> lock = hold();
        return history_.save();
    }

    void restore(const ctr::History::State& state) {
        const std::unique_lock<std::mutex> lock = hold();
        history_.restore(state);
    }

  private:
    // One thread at a time. Nobody waits here with the interpreter's lock, so that the holder can always take it.
    std::unique_lock<std::mutex> hold() const {
        nb::gil_scoped_release release;
        return std::unique_lock<std::mutex>(mutex_);
    }

    ctr::Robot robot_;
    ctr::History history_;
    mutable std::mutex mutex_;
};
