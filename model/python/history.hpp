// A simulation of what happens along a joint path (ctr/history.hpp), one thread at a time.
#pragma once

#include <mutex>

#include "arrays.hpp"
#include "ctr/history.hpp"

class PathHistory {
  public:
    PathHistory(const ctr::Robot& robot, const ctr::Accuracy& accuracy, const ctr::HistoryOptions& options)
        : robot_(robot), history_(robot, accuracy, options) {}

    int start(Vector theta, Vector l, Vector phi);
    nb::dict advance(Vector theta, Vector l);
    nb::dict follow(Matrix theta, Matrix l, const nb::object& progress);
    nb::object shape() const;
    nb::list friction() const;
    nb::object beside(Vector phi);
    ctr::History::State save() const;
    void restore(const ctr::History::State& state);

  private:
    std::unique_lock<std::mutex> hold() const;

    ctr::Robot robot_;
    ctr::History history_;
    mutable std::mutex mutex_;
};
