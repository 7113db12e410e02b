// The C interface between Rust (src/cosim/) and one Verilated module.
//
// Compiled once per model, together with the class `Vmodel` that Verilator made of the Verilog, and with
// `ports.h`, generated beside it, which holds
//   MODEL_INTERFACE        "name:width:in|out;..." of the ports, in the order of their indices
//   MODEL_HAS_CLK          1 if the module has an input `clk`, else 0
//   port_address(m, i)     the storage of port i
// With VM_TRACE_FST=1 (given by the build) the model can also write an FST trace.
//
// Every function with a `shim` takes what dynrt_create returned, from one thread at a time.

#include "Vmodel.h"
#include "verilated.h"
#if VM_TRACE_FST
#include "verilated_fst_c.h"
#endif
#include "ports.h"

#include <cstdint>
#include <memory>

#define SHIM_EXPORT extern "C" __attribute__((visibility("default")))

namespace {

// Times in a trace, in ns: cycle c lasts from 10 c, where its inputs change, over its rising edge at 10 c + 5.
constexpr uint64_t kCycleTime = 10;
constexpr uint64_t kEdgeTime = 5;

struct Shim {
    VerilatedContext context;  // one per model: models share nothing, so they may live on different threads
    std::unique_ptr<Vmodel> model;
    uint64_t cycle = 0;  // rising edges so far
#if VM_TRACE_FST
    std::unique_ptr<VerilatedFstC> trace;
    uint64_t trace_from = 0;   // first cycle traced
    uint64_t trace_until = 0;  // first cycle no longer traced
#endif

    Shim() {
#if VM_TRACE_FST
        context.traceEverOn(true);
#endif
        model = std::make_unique<Vmodel>(&context, "");
        model->eval();
    }

    ~Shim() {
#if VM_TRACE_FST
        close_trace();
#endif
        model->final();
    }

    void clock() {
#if VM_TRACE_FST
        const bool tracing = trace && cycle >= trace_from && cycle < trace_until;
        if (VL_UNLIKELY(tracing)) {
            model->eval();  // the new inputs, before the edge that samples them
            trace->dump(cycle * kCycleTime);
        }
#endif
#if MODEL_HAS_CLK
        model->clk = 1;
        model->eval();
#if VM_TRACE_FST
        if (VL_UNLIKELY(tracing)) trace->dump(cycle * kCycleTime + kEdgeTime);
#endif
        model->clk = 0;
#endif
        model->eval();
        ++cycle;
#if VM_TRACE_FST
        if (VL_UNLIKELY(trace && cycle >= trace_until)) close_trace();
#endif
    }

#if VM_TRACE_FST
    bool open_trace(const char* path, uint64_t from, uint64_t until) {
        close_trace();
        trace = std::make_unique<VerilatedFstC>();
        trace->set_time_unit("1ns");
        trace->set_time_resolution("1ns");
        model->trace(trace.get(), 99);
        trace->open(path);
        if (!trace->isOpen()) {
            trace.reset();
            return false;
        }
        trace_from = from;
        trace_until = until;
        return true;
    }

    void close_trace() {
        if (!trace) return;
        trace->close();
        trace.reset();
    }
#endif
};

}  // namespace

SHIM_EXPORT const char* dynrt_interface() { return MODEL_INTERFACE; }

SHIM_EXPORT Shim* dynrt_create() { return new Shim; }

SHIM_EXPORT void dynrt_destroy(Shim* shim) { delete shim; }

SHIM_EXPORT void* dynrt_port(Shim* shim, uint32_t index) { return port_address(*shim->model, index); }

SHIM_EXPORT void dynrt_clock(Shim* shim, uint64_t cycles) {
    while (cycles--) shim->clock();
}

SHIM_EXPORT void dynrt_eval(Shim* shim) { shim->model->eval(); }

SHIM_EXPORT int dynrt_traced() { return VM_TRACE_FST; }

// Traces cycles from `from` to just before `until`; 0 if the file cannot be opened or this model has no traces.
SHIM_EXPORT int dynrt_trace_open(Shim* shim, const char* path, uint64_t from, uint64_t until) {
#if VM_TRACE_FST
    return shim->open_trace(path, from, until);
#else
    (void)shim, (void)path, (void)from, (void)until;
    return 0;
#endif
}

SHIM_EXPORT void dynrt_trace_close(Shim* shim) {
#if VM_TRACE_FST
    shim->close_trace();
#else
    (void)shim;
#endif
}
