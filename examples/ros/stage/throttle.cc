// Hold Stage to a multiple of real time: in the world file, in one model,
//
//     ctrl "throttle 5"
//
// Headless, Stage runs as fast as the machine does, hundreds of times real time, and waits for no
// robot. Build it beside the world file and name its folder in STAGEPATH:
//
//     g++ -O2 -shared -fPIC $(pkg-config --cflags stage) -o throttle.so throttle.cc

#include <stage.hh>

#include <chrono>
#include <cstdio>
#include <thread>

namespace {

using Clock = std::chrono::steady_clock;
using Seconds = std::chrono::duration<double>;

const Seconds FORGIVEN(0.5);  // of delay that is made up for; of a longer one nothing is

struct Throttle {
    double rate;
    Clock::time_point due;

    // Wait until the step that was just computed is over in real time.
    void wait(const Stg::World *world) {
        const Seconds step(world->sim_interval / 1e6 / rate);
        const Clock::time_point now = Clock::now();
        if (due + FORGIVEN < now)
            due = now;
        due += std::chrono::duration_cast<Clock::duration>(step);
        std::this_thread::sleep_until(due);
    }
};

int updated(Stg::Model *model, void *throttle) {
    static_cast<Throttle *>(throttle)->wait(model->GetWorld());
    return 0;  // call again
}

}  // namespace

extern "C" int Init(Stg::Model *model, Stg::CtrlArgs *args) {
    double rate = 0;
    if (std::sscanf(args->worldfile.c_str(), "%*s %lf", &rate) != 1 || !(rate > 0)) {
        std::fprintf(stderr, "throttle: expected ctrl \"throttle RATE\", RATE above 0\n");
        return 1;
    }
    std::printf("throttle: %g times real time\n", rate);
    model->AddCallback(Stg::Model::CB_UPDATE, updated, new Throttle{rate, Clock::now()});
    model->Subscribe();  // a model without subscribers is not updated
    return 0;
}
