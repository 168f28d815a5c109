use std::process::Command;
use surgtpgs_tests::{cargo, workspace};

/// Crates that open connections, or make them secure.
const NETWORK: [&str; 22] = [
    "reqwest",
    "hyper",
    "ureq",
    "curl",
    "curl-sys",
    "isahc",
    "attohttpc",
    "minreq",
    "surf",
    "h2",
    "quinn",
    "tokio",
    "async-std",
    "socket2",
    "mio",
    "rustls",
    "native-tls",
    "openssl",
    "openssl-sys",
    "hf-hub",
    "tungstenite",
    "trust-dns-resolver",
];

#[test]
fn no_network_crate_is_in_the_shipped_tree() {
    let tree = Command::new(cargo())
        .args(["tree", "--package", "surgtpgs", "--edges", "normal", "--prefix", "none", "--format", "{p}"])
        .current_dir(workspace())
        .output()
        .unwrap();
    let tree = String::from_utf8_lossy(&tree.stdout).into_owned();
    let names: Vec<&str> = tree.lines().filter_map(|l| l.split_whitespace().next()).collect();
    assert!(names.contains(&"surgtpgs-core"), "cargo tree said nothing useful:\n{tree}");
    let found: Vec<_> = names.iter().filter(|n| NETWORK.contains(n)).collect();
    assert!(found.is_empty(), "network crates in the tree: {found:?}");
}
