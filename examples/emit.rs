fn main() {
    let name = std::env::args().nth(1).unwrap_or("virtex4-lx160".into());
    let c = dynrt::config::Config::load(&name).unwrap();
    let m = dynrt::hw::emit(&c).unwrap_or_else(|e| {
        eprintln!("{e}");
        std::process::exit(1)
    });
    let dir = std::env::args().nth(2).unwrap();
    std::fs::create_dir_all(&dir).unwrap();
    for (f, t) in m.design.files() {
        std::fs::write(format!("{dir}/{f}"), t).unwrap();
    }
    for x in m.design.modules() {
        println!("{} {:?}", x.name(), x.latency());
    }
}
