use surgtpgs_tests::run_in;

#[test]
#[ignore = "takes minutes; check.sh runs it last"]
fn without_a_display_the_demo_runs_into_a_folder_with_a_report() {
    let folder = tempfile::tempdir().unwrap();
    // The second time, all of the first has to be replaced.
    run_in::<&str>(folder.path(), &[]).ok();
    let run = run_in::<&str>(folder.path(), &[]).ok();
    let out = folder.path().join("surgtpgs-demo");
    for file in
        ["scene.safetensors", "report.md", "report.json", "figures/reconstruction.png", "figures/answers.png"]
    {
        assert!(out.join(file).exists(), "{file} is missing");
    }
    let masked = std::fs::read_to_string(out.join("masked-frames/provenance.json")).unwrap();
    assert!(masked.contains("\"complete\": true"));

    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
    let [psnr, blend] = ["psnr_masked_db", "blend_psnr_db"].map(|key| report["eval"][key].as_f64().unwrap());
    assert!(psnr > blend + 3.0, "{psnr} dB, a blend of the frames around {blend} dB");
    let classes = report["eval"]["iou"]["strict"]["classes"].as_object().unwrap();
    assert_eq!(classes.len(), 5);
    assert!(classes.values().all(|iou| iou.as_f64().unwrap() > 0.9), "{classes:?}");
    let found = |text: &str| {
        let prompts = report["query"]["prompts"].as_array().unwrap();
        let prompt = prompts.iter().find(|p| p["text"] == text).unwrap();
        prompt["frames"].as_array().unwrap().iter().filter(|f| f["found"] == true).count()
    };
    assert!(found("gallbladder") > 40 && found("liver") > 40, "{}", run.stdout);
    assert_eq!(found("spaceship"), 0, "{}", run.stdout);
    assert!(run.stdout.contains("spaceship") && run.stdout.contains("not in this recording"));
}
