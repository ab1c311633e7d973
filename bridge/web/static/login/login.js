// The login page: asks for a token, or logs out. A login sets a cookie that scripts cannot read, and opens the console.

const byId = (id) => document.getElementById(id);

async function login(token) {
  const answer = await fetch("login", {
    method: "POST",
    headers: { "content-type": "application/json" },
    body: JSON.stringify({ token }),
  });
  if (!answer.ok) throw new Error((await answer.text()).trim());
}

/** A client that is logged in may log out, or log in with another token. */
async function known() {
  const answer = await fetch("whoami", { cache: "no-store" }).catch(() => null);
  byId("known").hidden = !answer?.ok;
  if (answer?.ok) byId("name").textContent = `You are logged in as ${(await answer.json()).name}.`;
}

byId("out").addEventListener("click", async () => {
  await fetch("logout", { method: "POST" }).catch(() => null);
  known();
});

byId("form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const go = byId("go");
  go.disabled = true;
  byId("why").textContent = "";
  try {
    await login(byId("token").value.trim());
    location.replace("./");
  } catch (error) {
    const why = error instanceof TypeError ? "the console does not respond" : error.message;
    byId("why").textContent = `Not logged in: ${why}.`;
    go.disabled = false;
    byId("token").select();
  }
});

known();
